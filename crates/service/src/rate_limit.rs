//! Limits log lines that may occur with every message: logs one per period and counts the rest.

use parking_lot::Mutex;
use std::num::NonZeroU64;
use std::time::Duration;
use tokio::time::Instant;

/// Lets one log line per period through and counts the suppressed ones.
#[derive(Debug)]
pub struct RateLimit {
    period: Duration,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// The time of the last line.
    last: Option<Instant>,
    /// The number of those suppressed since.
    held_back: u64,
}

impl RateLimit {
    /// Lets at most one line per `period` through.
    pub const fn new(period: Duration) -> Self {
        let state = State {
            last: None,
            held_back: 0,
        };
        Self {
            period,
            state: Mutex::new(state),
        }
    }

    /// Calls `log` at most once per period, with the number of calls suppressed since the last one. A line has no field for it
    /// if there were none: `tracing` leaves `None` out.
    pub fn log(&self, log: impl FnOnce(Option<NonZeroU64>)) {
        let mut state = self.state.lock();
        if let Some(last) = state.last
            && last.elapsed() < self.period
        {
            state.held_back += 1;
            return;
        }
        let held_back = NonZeroU64::new(state.held_back);
        *state = State {
            last: Some(Instant::now()),
            held_back: 0,
        };
        // `log` may take its time, or call this again.
        drop(state);
        log(held_back);
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
