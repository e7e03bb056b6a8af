//! The wall clock, and times and figures in the form that messages use.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Milliseconds per day.
pub const DAY_MS: i64 = 86_400_000;

/// The present time by both clocks.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// The monotonic time, for decisions.
    pub at: Instant,
    /// The wall clock, milliseconds since the Unix epoch.
    pub unix_ms: i64,
}

impl Now {
    /// The present time of this machine.
    pub fn system() -> Self {
        Self {
            at: Instant::now(),
            unix_ms: unix_milliseconds(),
        }
    }
}

/// Nanoseconds since the Unix epoch; 0 if the clock is set to an earlier time.
pub fn unix_nanoseconds() -> u64 {
    u64::try_from(since_epoch().as_nanos()).unwrap_or(0)
}

/// Milliseconds since the Unix epoch, the unit of the hub's database; 0 if the clock is set to an earlier time.
pub fn unix_milliseconds() -> i64 {
    i64::try_from(since_epoch().as_millis()).unwrap_or(0)
}

fn since_epoch() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

/// A duration in milliseconds, rounded to the microsecond: further digits are clock noise.
pub fn milliseconds(duration: Duration) -> f64 {
    (duration.as_secs_f64() * 1e6).round() / 1e3
}

/// A duration in seconds, rounded to the millisecond, the form of ages in messages.
pub fn seconds(duration: Duration) -> f64 {
    (duration.as_secs_f64() * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_rounded_to_meaningful_digits() {
        assert_eq!(milliseconds(Duration::from_nanos(1_234_567)), 1.235);
        assert_eq!(seconds(Duration::from_micros(1_234_567)), 1.235);
    }
}
