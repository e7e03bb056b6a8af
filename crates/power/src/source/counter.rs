//! A hardware energy counter extended to rise without end: follows wraps and detects resets.

use std::sync::Arc;
use tokio::time::Instant;

/// No device draws more: a counter that rises faster was reset (for example after suspend) and did not wrap.
const IMPLAUSIBLE_WATTS: f64 = 10_000.0;

/// Follows one counter.
#[derive(Clone, Debug)]
pub(crate) struct Counter {
    pub name: Arc<str>,
    /// Joules per count.
    unit: f64,
    /// The highest count, after which the counter restarts at 0.
    range: u64,
    last: Option<(Instant, u64)>,
    counted: u64,
}

impl Counter {
    pub(crate) const fn new(name: Arc<str>, unit: f64, range: u64) -> Self {
        Self {
            name,
            unit,
            range,
            last: None,
            counted: 0,
        }
    }

    /// Records the counter's present value and returns the joules so far. If the counter was reset, its count since the
    /// last call, less than one interval's worth, is lost.
    pub(crate) fn update(&mut self, now: Instant, raw: u64) -> f64 {
        if let Some((then, before)) = self.last.replace((now, raw)) {
            let wrapped = || self.range.saturating_sub(before).saturating_add(raw);
            let rise = raw.checked_sub(before).unwrap_or_else(wrapped);
            // Counters move in steps: a short interval may show the joules of a longer one.
            let seconds = now.saturating_duration_since(then).as_secs_f64().max(0.1);
            if rise as f64 * self.unit <= IMPLAUSIBLE_WATTS * seconds {
                self.counted += rise;
            } else {
                tracing::warn!(counter = %self.name, raw, "an energy counter was reset; counting continues from its new value");
            }
        }
        self.joules()
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
        let range = 262_143_328_850;
        let mut counter = Counter::new("package-0".into(), 1e-6, range);
        for (second, raw, joules) in [
            (0, range - 1_000_000, 0.0),
            (1, 2_000_000, 3.0),
            (2, 1_000_000, 3.0),
            (3, 5_000_000, 7.0),
        ] {
            let counted = counter.update(at(second), raw);
            assert!((counted - joules).abs() < 1e-9, "after {second} s");
        }
    }
}
