//! Keeps the parts of the hub that do not work, with the reasons.

use parking_lot::Mutex;
use std::collections::BTreeMap;

/// The parts that do not work, with the reasons; empty when the hub is ready.
#[derive(Debug, Default)]
pub struct Readiness(Mutex<BTreeMap<&'static str, String>>);

impl Readiness {
    /// Notes that `part` does not work, with the reason.
    pub(crate) fn hold(&self, part: &'static str, reason: &str) {
        self.0.lock().insert(part, reason.to_owned());
    }

    /// Notes that `part` works.
    pub fn release(&self, part: &'static str) {
        self.0.lock().remove(part);
    }

    /// The reason of each part that does not work.
    pub(crate) fn reasons(&self) -> BTreeMap<&'static str, String> {
        self.0.lock().clone()
    }
}
