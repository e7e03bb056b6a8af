//! A hardware energy counter extended to rise without end: follows wraps and detects resets.

use tokio::time::Instant;

/// No device draws more: a counter that rises faster was reset (for example after suspend) and did not wrap.
const IMPLAUSIBLE_WATTS: f64 = 10_000.0;

/// Follows one counter.
#[derive(Clone, Debug)]
pub(crate) struct Counter {
    /// Joules per count.
    unit: f64,
    /// The highest count, after which the counter restarts at 0; `None` if it never does.
    range: Option<u64>,
    last: Option<(Instant, u64)>,
    counted: u64,
}

impl Counter {
    pub(crate) const fn new(unit: f64, range: Option<u64>) -> Self {
        Self {
            unit,
            range,
            last: None,
            counted: 0,
        }
    }

    /// Records the counter's present value. Returns false if the counter was reset: its count since the last call, less
    /// than one interval's worth, is lost.
    pub(crate) fn update(&mut self, now: Instant, raw: u64) -> bool {
        let mut sound = true;
        if let Some((then, before)) = self.last {
            let rise = match (raw.checked_sub(before), self.range) {
                (Some(rise), _) => Some(rise),
                (None, Some(range)) => Some(range.saturating_sub(before).saturating_add(raw)),
                (None, None) => None,
            };
            let seconds = now.saturating_duration_since(then).as_secs_f64().max(0.1);
            let plausible = rise.filter(|r| *r as f64 * self.unit <= IMPLAUSIBLE_WATTS * seconds);
            sound = plausible.is_some();
            self.counted += plausible.unwrap_or(0);
        }
        self.last = Some((now, raw));
        sound
    }

    /// Joules counted since the first update.
    pub(crate) fn joules(&self) -> f64 {
        self.counted as f64 * self.unit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn counting_continues_across_a_wrap_and_a_reset_adds_nothing() {
        let start = Instant::now();
        let at = |s: u64| start + Duration::from_secs(s);
        let mut counter = Counter::new(1e-6, Some(262_143_328_850));
        assert!(counter.update(at(0), 262_143_328_850 - 1_000_000));
        assert!(counter.update(at(1), 2_000_000));
        assert!((counter.joules() - 3.0).abs() < 1e-9);
        assert!(!counter.update(at(2), 1_000_000));
        assert!(counter.update(at(3), 5_000_000));
        assert!((counter.joules() - 7.0).abs() < 1e-9);
    }
}
