//! What the meter itself costs.

use std::time::Duration;

/// CPU time spent on reading the meter, and how long it has been read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeterCost {
    /// Readings asked for.
    pub polls: u64,
    /// CPU time of all of them, child processes included where the system tells it.
    pub cpu: Duration,
    /// Time since sampling began.
    pub elapsed: Duration,
}

impl MeterCost {
    /// CPU time as a share of one core, 0 to 1 (and more, for more than a core).
    pub fn share_of_core(&self) -> f64 {
        if self.elapsed.is_zero() {
            0.0
        } else {
            self.cpu.as_secs_f64() / self.elapsed.as_secs_f64()
        }
    }
}

/// CPU time of the calling thread since it was started.
pub(super) fn thread_cpu() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    Duration::new(seconds, u32::try_from(time.tv_nsec).unwrap_or(0))
}
