//! A frame-rate limit for pictures that are not decoded on their way.

use std::time::Duration;

/// Lets the first picture of each slot of time through: on average exactly the rate, whatever the camera's.
#[derive(Clone, Debug, Default)]
pub(super) struct RateSlots {
    last: Option<u64>,
}

impl RateSlots {
    /// Whether the picture at `time` may pass at most `rate` a second.
    pub(super) fn admit(&mut self, time: Duration, rate: Option<f64>) -> bool {
        let Some(rate) = rate else { return true };
        let slot = (time.as_secs_f64() * rate) as u64;
        self.last.replace(slot) != Some(slot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_kept_on_average_at_any_rate_of_the_camera() {
        for (camera, limit, passed) in [(25.0, 10.0, 100), (30.0, 10.0, 100), (5.0, 10.0, 50)] {
            let mut slots = RateSlots::default();
            let times = (0..(10.0 * camera) as u32).map(|n| f64::from(n) / camera + 0.001);
            let through = times
                .filter(|time| slots.admit(Duration::from_secs_f64(*time), Some(limit)))
                .count();
            assert_eq!(through, passed, "{camera} frames a second");
        }
        assert!(RateSlots::default().admit(Duration::ZERO, None));
    }
}
