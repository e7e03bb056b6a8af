//! The wall clock, and times and figures in the form that messages use.

use rustix::time::{ClockId, clock_gettime};
use std::hash::{BuildHasher, RandomState};
use std::sync::OnceLock;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Milliseconds per day.
pub const DAY_MS: i64 = 86_400_000;

/// The present time by all clocks.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// The monotonic time, for decisions.
    pub at: Instant,
    /// The wall clock, milliseconds since the Unix epoch.
    pub unix_ms: i64,
    /// The time since the machine was started, for ages that outlive the process.
    pub uptime: Uptime,
}

/// The time since a machine was started. Nobody sets this clock, and it goes on while the machine sleeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Uptime {
    /// Which start it was: a random number.
    pub boot: u64,
    /// Seconds since then.
    pub s: u64,
}

/// The beginning of the system's random number for this start.
fn boot_id() -> Option<u64> {
    let id = std::fs::read_to_string("/proc/sys/kernel/random/boot_id")
        .ok()?
        .replace('-', "");
    u64::from_str_radix(id.get(..16)?, 16).ok()
}

impl Uptime {
    /// The time of this machine.
    fn system() -> Self {
        static BOOT: OnceLock<u64> = OnceLock::new();
        let boot = BOOT.get_or_init(|| match boot_id() {
            Some(id) => id,
            // Where the system does not tell, each process counts as a start of its own.
            None => RandomState::new().hash_one("boot"),
        });
        let time = clock_gettime(ClockId::Boottime);
        Self {
            boot: *boot,
            s: u64::try_from(time.tv_sec).unwrap_or(0),
        }
    }

    /// Seconds since an earlier time; `None` if the machine was started since then.
    pub fn since(self, earlier: Self) -> Option<u64> {
        if self.boot != earlier.boot {
            return None;
        }
        self.s.checked_sub(earlier.s)
    }
}

impl Now {
    /// The present time of this machine.
    pub fn system() -> Self {
        Self {
            at: Instant::now(),
            unix_ms: unix_milliseconds(),
            uptime: Uptime::system(),
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

    #[test]
    fn ages_by_the_uptime_are_known_until_the_machine_is_started_again() {
        let now = Now::system().uptime;
        assert_eq!(now.since(now), Some(0));
        assert!(now.s > 0);
        assert!(now.boot != 0);
        let earlier = Uptime {
            s: now.s - 1,
            ..now
        };
        assert_eq!(now.since(earlier), Some(1));
        assert_eq!(earlier.since(now), None);
        let other = Uptime {
            boot: !now.boot,
            ..now
        };
        assert_eq!(now.since(other), None);
    }
}
