//! The wall clock, and times and figures in the form of messages.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

pub use albireo_wire::significant;

/// The present, by both clocks.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// What decides.
    pub at: Instant,
    /// The wall clock, milliseconds since the Unix epoch.
    pub unix_ms: i64,
}

impl Now {
    /// The present of this machine.
    pub fn system() -> Self {
        Self {
            at: Instant::now(),
            unix_ms: unix_milliseconds(),
        }
    }
}

/// Nanoseconds since the Unix epoch; 0 for a clock set before it.
pub fn unix_nanoseconds() -> u64 {
    u64::try_from(since_epoch().as_nanos()).unwrap_or(0)
}

/// Milliseconds since the Unix epoch, the unit of the hub's database; 0 for a clock set before it.
pub fn unix_milliseconds() -> i64 {
    i64::try_from(since_epoch().as_millis()).unwrap_or(0)
}

fn since_epoch() -> Duration {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default()
}

/// A length of time in milliseconds, to the microsecond: what is behind that is noise of the clock.
pub fn milliseconds(duration: Duration) -> f64 {
    (duration.as_secs_f64() * 1e6).round() / 1e3
}

/// A length of time in seconds, to the millisecond, as messages have ages.
pub fn seconds(duration: Duration) -> f64 {
    (duration.as_secs_f64() * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_the_digits_that_mean_something() {
        assert_eq!(milliseconds(Duration::from_nanos(1_234_567)), 1.235);
        assert_eq!(seconds(Duration::from_micros(1_234_567)), 1.235);
        assert_eq!(significant(1.912_345_678e-4, 6), 1.912_35e-4);
        assert_eq!(significant(0.0, 6), 0.0);
        assert!(significant(f64::NAN, 6).is_nan());
    }
}
