//! The parts of the hub that do not work, and why.

use parking_lot::Mutex;
use std::collections::BTreeMap;

/// The parts that do not work; none of them when the hub is ready.
#[derive(Debug, Default)]
pub struct Readiness(Mutex<BTreeMap<&'static str, String>>);

impl Readiness {
    /// Notes that `part` does not work, and why.
    pub(crate) fn hold(&self, part: &'static str, reason: &str) {
        self.0.lock().insert(part, reason.to_owned());
    }

    /// Notes that `part` works.
    pub fn release(&self, part: &'static str) {
        self.0.lock().remove(part);
    }

    /// Why each broken part does not work.
    pub(crate) fn reasons(&self) -> BTreeMap<&'static str, String> {
        self.0.lock().clone()
    }
}
