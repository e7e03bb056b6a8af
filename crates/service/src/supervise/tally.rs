//! Counts failures and restarts of tasks.

use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What is counted of one task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskCounts {
    /// Times it panicked, failed, or ended unasked.
    pub failures: u64,
    /// Times it was restarted.
    pub restarts: u64,
}

#[derive(Debug, Default)]
struct Counters {
    failures: AtomicU64,
    restarts: AtomicU64,
}

/// The counts of one task, to add to.
#[derive(Clone, Debug)]
pub(super) struct Count(Arc<Counters>);

impl Count {
    pub(super) fn failed(&self) {
        self.0.failures.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn restarted(&self) {
        self.0.restarts.fetch_add(1, Ordering::Relaxed);
    }
}

/// The counts of all tasks of a service, by name. Clones are of the same service.
#[derive(Clone, Debug, Default)]
pub struct TaskTally(Arc<Mutex<BTreeMap<String, Arc<Counters>>>>);

impl TaskTally {
    pub(super) fn of(&self, name: &str) -> Count {
        let mut tasks = self.0.lock();
        Count(Arc::clone(tasks.entry(name.to_owned()).or_default()))
    }

    /// Every task ever started, with its counts.
    pub fn counts(&self) -> Vec<(String, TaskCounts)> {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        (self.0.lock().iter())
            .map(|(name, counters)| {
                let counts = TaskCounts {
                    failures: read(&counters.failures),
                    restarts: read(&counters.restarts),
                };
                (name.clone(), counts)
            })
            .collect()
    }
}
