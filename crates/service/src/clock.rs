//! The wall clock, and times and figures in the form of messages.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

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

/// A time of the wall clock, milliseconds since the Unix epoch, as people and logs write it (RFC 3339, UTC):
/// `2026-11-22T03:20:07.123Z`.
pub(crate) fn rfc3339(ms: i64) -> String {
    let (days, of_day) = (ms.div_euclid(86_400_000), ms.rem_euclid(86_400_000));
    // Howard Hinnant, "chrono-Compatible Low-Level Date Algorithms", `civil_from_days`: years begin in March.
    let days = days + 719_468;
    let era = days.div_euclid(146_097);
    let of_era = days.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = (month_from_march + 2) % 12 + 1;
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    let (hours, minutes) = (of_day / 3_600_000, of_day / 60_000 % 60);
    let (seconds, ms) = (of_day / 1000 % 60, of_day % 1000);
    format!("{year:04}-{month:02}-{day:02}T{hours:02}:{minutes:02}:{seconds:02}.{ms:03}Z")
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

/// A number rounded to that many significant digits, for messages.
pub fn significant(value: f64, digits: usize) -> f64 {
    let rounded = format!("{value:.*e}", digits.saturating_sub(1)).parse();
    rounded.unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_told_with_the_digits_that_mean_something() {
        assert_eq!(milliseconds(Duration::from_nanos(1_234_567)), 1.235);
        assert_eq!(seconds(Duration::from_micros(1_234_567)), 1.235);
        assert_eq!(significant(1.912_345_678e-4, 6), 1.912_35e-4);
        assert_eq!(significant(0.0, 6), 0.0);
        assert!(significant(f64::NAN, 6).is_nan());
    }

    #[test]
    fn times_are_written_as_rfc_3339_has_them() {
        // `date -u -d @SECONDS --iso-8601=seconds` gives the same.
        for (ms, written) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_827_696_789, "2000-02-29T12:34:56.789Z"),
            (1_709_164_799_000, "2024-02-28T23:59:59.000Z"),
            (1_709_164_800_000, "2024-02-29T00:00:00.000Z"),
            (1_800_000_000_001, "2027-01-15T08:00:00.001Z"),
            (4_107_542_400_000, "2100-03-01T00:00:00.000Z"),
        ] {
            assert_eq!(rfc3339(ms), written);
        }
    }
}
