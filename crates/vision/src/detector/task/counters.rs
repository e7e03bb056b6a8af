//! What the task counts.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// The numbers as they are kept.
#[derive(Debug, Default)]
pub struct Counters {
    pub(super) completed: AtomicU64,
    pub(super) batches: AtomicU64,
    pub(super) timed_out: AtomicU64,
    pub(super) failed: AtomicU64,
    pub(super) panicked: AtomicU64,
    pub(super) refused: AtomicU64,
    pub(super) cancelled: AtomicU64,
    pub(super) rebuilds: AtomicU64,
    pub(super) rebuilds_failed: AtomicU64,
    pub(super) abandoned: AtomicU64,
    pub(super) waiting: AtomicU64,
    pub(super) spare: AtomicU64,
}

/// What a task has counted since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskCounters {
    /// Pictures that were answered.
    pub completed: u64,
    /// Runs that ended well; fewer than the pictures where several shared a run.
    pub batches: u64,
    /// Runs that took longer than the limit.
    pub timed_out: u64,
    /// Runs that ended with an error.
    pub failed: u64,
    /// Runs that panicked.
    pub panicked: u64,
    /// Pictures turned away because the session was being rebuilt or the task stopped.
    pub refused: u64,
    /// Pictures whose asker had gone before their turn came.
    pub cancelled: u64,
    /// Attempts to build a new session after a failure.
    pub rebuilds: u64,
    /// Those of them that failed.
    pub rebuilds_failed: u64,
    /// Threads that still hang in a run that was given up: a number that goes down again.
    pub abandoned: u64,
    /// Pictures that wait for their turn: a number that goes down again.
    pub waiting: u64,
    /// Pictures that were answered while nobody else asked, on behalf of no frame; in none of the other numbers.
    pub spare: u64,
}

/// A task's counters for whoever shows them: does not keep the task running.
#[derive(Clone, Debug)]
pub struct TaskMeter(pub(super) Arc<Counters>);

impl TaskMeter {
    /// What the task has counted since it started.
    pub fn read(&self) -> TaskCounters {
        self.0.snapshot()
    }
}

impl Counters {
    pub(super) fn add(counter: &AtomicU64) {
        Self::add_many(counter, 1);
    }

    pub(super) fn add_many(counter: &AtomicU64, number: usize) {
        counter.fetch_add(number as u64, Ordering::Relaxed);
    }

    pub(super) fn snapshot(&self) -> TaskCounters {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        TaskCounters {
            completed: read(&self.completed),
            batches: read(&self.batches),
            timed_out: read(&self.timed_out),
            failed: read(&self.failed),
            panicked: read(&self.panicked),
            refused: read(&self.refused),
            cancelled: read(&self.cancelled),
            rebuilds: read(&self.rebuilds),
            rebuilds_failed: read(&self.rebuilds_failed),
            abandoned: read(&self.abandoned),
            waiting: read(&self.waiting),
            spare: read(&self.spare),
        }
    }
}
