//! Limits log lines that may occur with every message: logs one per period and counts the rest.

use parking_lot::Mutex;
use std::num::NonZeroU64;
use std::time::Duration;
use tokio::time::Instant;

/// Lets one log line per period through and counts the suppressed ones.
#[derive(Debug)]
pub struct RateLimit {
    period: Duration,
    /// The time of the last line, and the number of those suppressed since.
    last: Mutex<(Option<Instant>, u64)>,
}

impl RateLimit {
    /// Lets at most one line per `period` through.
    pub const fn new(period: Duration) -> Self {
        let last = Mutex::new((None, 0));
        Self { period, last }
    }

    /// Calls `log` at most once per period, with the number of calls suppressed since the last one. A line has no field for it
    /// if there were none: `tracing` leaves `None` out.
    pub fn log(&self, log: impl FnOnce(Option<NonZeroU64>)) {
        let mut last = self.last.lock();
        if last.0.is_some_and(|at| at.elapsed() < self.period) {
            last.1 += 1;
            return;
        }
        let (_, held_back) = std::mem::replace(&mut *last, (Some(Instant::now()), 0));
        drop(last);
        log(NonZeroU64::new(held_back));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn one_event_per_period_is_logged_and_the_rest_are_counted() {
        let limit = RateLimit::new(Duration::from_secs(10));
        let logged = || {
            let mut logged = None;
            limit.log(|held_back| logged = Some(held_back.map(NonZeroU64::get)));
            logged
        };
        assert_eq!(logged(), Some(None));
        for _ in 0..7 {
            assert_eq!(logged(), None);
        }
        tokio::time::advance(Duration::from_secs(10)).await;
        assert_eq!(logged(), Some(Some(7)));
    }
}
