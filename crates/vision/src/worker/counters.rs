//! What a worker counts.

use parking_lot::Mutex;
use std::sync::Arc;

/// What a worker has counted since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerCounts {
    /// Pictures that were answered.
    pub completed: u64,
    /// Runs that ended well; fewer than the pictures where several shared a run.
    pub batches: u64,
    /// Runs that took longer than the limit.
    pub timed_out: u64,
    /// Runs that ended with an error, or with results that are all impossible.
    pub failed: u64,
    /// Runs that panicked.
    pub panicked: u64,
    /// Pictures turned away because no session could take them.
    pub refused: u64,
    /// Pictures whose requester gave up before their turn.
    pub cancelled: u64,
    /// Attempts to build a new session after a failure.
    pub rebuilds: u64,
    /// Those of them that failed.
    pub rebuilds_failed: u64,
    /// Pictures that wait for their turn: a number that goes down again.
    pub waiting: u64,
    /// Pictures that were answered while no camera waited, on behalf of no frame; in none of the other numbers.
    pub spare: u64,
}

/// A worker's counters for metrics: does not keep the worker running.
#[derive(Clone, Debug, Default)]
pub struct WorkerMeter(Arc<Mutex<WorkerCounts>>);

impl WorkerMeter {
    /// What the worker has counted since it started.
    pub fn read(&self) -> WorkerCounts {
        *self.0.lock()
    }

    pub(super) fn update(&self, update: impl FnOnce(&mut WorkerCounts)) {
        update(&mut self.0.lock());
    }
}
