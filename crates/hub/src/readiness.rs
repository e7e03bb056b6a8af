//! The parts of a hub whose faults its readiness reports.

use parking_lot::Mutex;
use std::collections::BTreeMap;

/// Parts that do not work; empty when the hub is ready.
#[derive(Debug, Default)]
pub struct Readiness(Mutex<BTreeMap<&'static str, String>>);

impl Readiness {
    /// Says that `part` does not work.
    pub(crate) fn hold(&self, part: &'static str, reason: &str) {
        self.0.lock().insert(part, reason.to_owned());
    }

    /// Says that `part` works.
    pub fn release(&self, part: &'static str) {
        self.0.lock().remove(part);
    }

    /// What does not work, by part.
    pub(crate) fn reasons(&self) -> BTreeMap<&'static str, String> {
        self.0.lock().clone()
    }
}
