//! Measures how many frames a camera sends per second.

/// Intervals over which the mean is taken, roughly: a second or two of most cameras.
const MEMORY: f64 = 32.0;

/// A longer interval, seconds, is an interruption and not a rate.
const LONGEST_S: f64 = 10.0;

/// Intervals after which the mean no longer depends on the first one.
const SETTLED: u32 = 64;

/// The rate at which a camera takes its pictures, by their own times.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FrameRate {
    /// Seconds.
    mean_interval: Option<f64>,
    /// The number of intervals so far.
    intervals: u32,
    last_ns: Option<u64>,
}

impl FrameRate {
    /// Adds a picture taken at `time_ns`, `step` frames after the one before. Times that stand still or go back do not
    /// count.
    pub(super) fn add(&mut self, time_ns: u64, step: u32) {
        let last = self.last_ns.replace(time_ns);
        let Some(between_ns) = last.and_then(|last| time_ns.checked_sub(last)) else {
            return;
        };
        let interval = between_ns as f64 * 1e-9 / f64::from(step.max(1));
        if interval == 0.0 || interval > LONGEST_S {
            return;
        }
        self.intervals = self.intervals.saturating_add(1);
        let share = 1.0 / f64::from(self.intervals).min(MEMORY);
        let mean = self.mean_interval.get_or_insert(interval);
        *mean += (interval - *mean) * share;
    }

    /// Frames per second; `None` before the second frame.
    pub(super) fn rate(&self) -> Option<f64> {
        self.mean_interval.map(|interval| 1.0 / interval)
    }

    /// True if enough frames have arrived to tell a person the rate.
    pub(super) fn is_settled(&self) -> bool {
        self.intervals >= SETTLED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_pictures_whatever_is_lost_late_or_interrupted() {
        let mut rate = FrameRate::default();
        assert_eq!(rate.rate(), None);
        let mut previous = 0;
        for frame in 0..400_u64 {
            // Every seventh frame is lost, and the times of the others are up to 5 ms off.
            if frame % 7 == 3 {
                continue;
            }
            let step = u32::try_from(frame - previous).unwrap();
            previous = frame;
            let jitter_ns = frame * 7919 % 5_000_000;
            rate.add(1_000_000_000 + frame * 40_000_000 + jitter_ns, step);
        }
        assert!(rate.is_settled());
        let is_right = |rate: FrameRate| (rate.rate().unwrap() - 25.0).abs() < 0.5;
        assert!(is_right(rate), "{rate:?}");
        // The clock is set back, stands still, and jumps by an hour.
        for time_ns in [5, 5, 5, 3_600_000_000_000] {
            rate.add(time_ns, 1);
        }
        assert!(is_right(rate), "{rate:?}");
    }
}
