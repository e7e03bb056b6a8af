//! Limits log lines that may occur with every message: logs one per period and counts the rest.

use parking_lot::Mutex;
use std::time::Duration;
use tokio::time::Instant;

/// Lets one event per period through and counts the suppressed ones.
#[derive(Debug)]
pub struct RateLimit {
    period: Duration,
    last: Option<Instant>,
    held_back: u64,
}

impl RateLimit {
    /// Lets at most one event per `period` through.
    pub const fn new(period: Duration) -> Self {
        Self {
            period,
            last: None,
            held_back: 0,
        }
    }

    /// Returns the number of events suppressed since the last one that passed if the event at `now` may pass, else
    /// `None`.
    pub fn admit(&mut self, now: Instant) -> Option<u64> {
        if self.last.is_some_and(|last| now - last < self.period) {
            self.held_back += 1;
            return None;
        }
        self.last = Some(now);
        Some(std::mem::take(&mut self.held_back))
    }
}

/// A limit of one line per ten seconds, shared by threads.
#[derive(Debug)]
pub struct SharedLimit(Mutex<RateLimit>);

impl Default for SharedLimit {
    fn default() -> Self {
        Self::new()
    }
}

impl SharedLimit {
    /// Creates a limit that has not let anything through yet.
    pub const fn new() -> Self {
        Self(parking_lot::const_mutex(RateLimit::new(
            Duration::from_secs(10),
        )))
    }

    /// Calls `log` with the number of calls suppressed since the last one, at most once per period.
    pub fn log(&self, log: impl FnOnce(u64)) {
        let admitted = self.0.lock().admit(Instant::now());
        if let Some(held_back) = admitted {
            log(held_back);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn one_event_per_period_is_logged_and_the_rest_are_counted() {
        let mut limit = RateLimit::new(Duration::from_secs(10));
        assert_eq!(limit.admit(Instant::now()), Some(0));
        for _ in 0..7 {
            assert_eq!(limit.admit(Instant::now()), None);
        }
        tokio::time::advance(Duration::from_secs(10)).await;
        assert_eq!(limit.admit(Instant::now()), Some(7));
    }
}
