//! The counters of a worker.

use parking_lot::Mutex;
use std::sync::Arc;

/// A worker's counts since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerCounts {
    /// Answered pictures.
    pub completed: u64,
    /// Successful runs; fewer than the pictures if several shared a run.
    pub batches: u64,
    /// Runs that took longer than the limit.
    pub timed_out: u64,
    /// Runs that ended with an error, or with only impossible results.
    pub failed: u64,
    /// Runs that panicked.
    pub panicked: u64,
    /// Pictures refused because no session could accept them.
    pub refused: u64,
    /// Pictures whose requester gave up before their turn.
    pub cancelled: u64,
    /// Attempts to build a new session after a failure.
    pub rebuilds: u64,
    /// Attempts to rebuild that failed.
    pub rebuilds_failed: u64,
    /// Pictures that wait for their turn: a gauge, not a counter.
    pub waiting: u64,
    /// Pictures answered on behalf of no frame, while no asker waited; not included in the other counts.
    pub spare: u64,
}

/// A worker's counters for metrics; does not keep the worker running.
#[derive(Clone, Debug, Default)]
pub struct WorkerMeter(Arc<Mutex<WorkerCounts>>);

impl WorkerMeter {
    /// Returns the counts since the worker started.
    pub fn read(&self) -> WorkerCounts {
        *self.0.lock()
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut WorkerCounts)) {
        change(&mut self.0.lock());
    }
}
