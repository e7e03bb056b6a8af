//! The board's condition at one moment, and over a span: temperature, throttling, clocks, power mode.

use albireo_wire::BoardState;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// What is known of the board at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Condition {
    /// The hottest sensor and its temperature, °C.
    pub hottest: Option<(Arc<str>, f64)>,
    /// Whether clocks are held back by heat, current or power.
    pub throttled: Option<bool>,
    /// Mean clock of the CPU cores that are on, MHz.
    pub cpu_mhz: Option<f64>,
    /// GPU clock, MHz.
    pub gpu_mhz: Option<f64>,
    /// Power mode.
    pub mode: Option<Arc<str>>,
}

impl Condition {
    /// What two sources tell of the same moment: the hotter sensor, throttling by either, and of the rest
    /// what `self` tells first.
    pub fn and(self, other: Self) -> Self {
        let hottest = match (self.hottest, other.hottest) {
            (Some(a), Some(b)) => Some(if b.1 > a.1 { b } else { a }),
            (one, None) | (None, one) => one,
        };
        Self {
            hottest,
            throttled: match (self.throttled, other.throttled) {
                (Some(a), Some(b)) => Some(a || b),
                (one, None) | (None, one) => one,
            },
            cpu_mhz: self.cpu_mhz.or(other.cpu_mhz),
            gpu_mhz: self.gpu_mhz.or(other.gpu_mhz),
            mode: self.mode.or(other.mode),
        }
    }
}

/// Not the `PMIC` zone of Jetson boards: it reads a constant, 50 °C or 100 °C.
pub(super) fn is_a_sensor(name: &str) -> bool {
    !name.to_ascii_lowercase().starts_with("pmic")
}

/// Conditions of the last while, oldest first.
#[derive(Debug)]
pub(super) struct Conditions {
    keep: Duration,
    kept: VecDeque<(Instant, Condition)>,
}

impl Conditions {
    pub(super) fn new(keep: Duration) -> Self {
        Self {
            keep,
            kept: VecDeque::new(),
        }
    }

    pub(super) fn push(&mut self, at: Instant, condition: Condition) {
        self.kept.push_back((at, condition));
        while self
            .kept
            .front()
            .is_some_and(|(first, _)| at.saturating_duration_since(*first) > self.keep)
        {
            self.kept.pop_front();
        }
    }

    /// The state over `[start, end]`; a span shorter than the time between two conditions has the last one
    /// before its end. `None` where nothing is known.
    pub(super) fn state(&self, start: Instant, end: Instant) -> Option<BoardState> {
        let last = self.kept.partition_point(|(at, _)| *at <= end);
        let first = self.kept.partition_point(|(at, _)| *at < start);
        let first = first.min(last.saturating_sub(1));
        let mut state = BoardState::default();
        let mut modes: Vec<&str> = Vec::new();
        let (mut cpu, mut gpu) = (Mean::default(), Mean::default());
        for (_, condition) in self.kept.range(first..last) {
            if let Some((sensor, celsius)) = &condition.hottest
                && state.hottest_celsius.is_none_or(|c| *celsius > c)
            {
                state.hottest_celsius = Some(*celsius);
                state.hottest_sensor = Some(sensor.to_string());
            }
            if let Some(throttled) = condition.throttled {
                state.throttled = Some(throttled || state.throttled.unwrap_or(false));
            }
            if let Some(mode) = &condition.mode
                && modes.last() != Some(&&**mode)
            {
                modes.push(mode);
            }
            cpu.add(condition.cpu_mhz);
            gpu.add(condition.gpu_mhz);
        }
        state.power_mode = (!modes.is_empty()).then(|| modes.join(", then "));
        state.cpu_mhz = cpu.value();
        state.gpu_mhz = gpu.value();
        (state != BoardState::default()).then_some(state)
    }
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: u32,
}

impl Mean {
    fn add(&mut self, value: Option<f64>) {
        if let Some(value) = value {
            self.sum += value;
            self.count += 1;
        }
    }

    fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / f64::from(self.count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn condition(sensor: &str, celsius: f64, throttled: bool, mhz: f64, mode: &str) -> Condition {
        Condition {
            hottest: Some((sensor.into(), celsius)),
            throttled: Some(throttled),
            cpu_mhz: Some(mhz),
            gpu_mhz: None,
            mode: Some(mode.into()),
        }
    }

    #[test]
    fn a_span_tells_the_hottest_moment_any_throttling_and_the_mean_clock() {
        let start = Instant::now();
        let at = |s| start + Duration::from_secs(s);
        let mut kept = Conditions::new(Duration::from_secs(600));
        kept.push(at(0), condition("cpu", 90.0, true, 9999.0, "15W"));
        kept.push(at(1), condition("cpu", 50.0, false, 1000.0, "15W"));
        kept.push(at(2), condition("gpu", 70.0, true, 2000.0, "MAXN"));
        kept.push(at(3), condition("cpu", 60.0, false, 3000.0, "MAXN"));
        let state = kept.state(at(1), at(3)).unwrap();
        assert_eq!(state.hottest_celsius, Some(70.0));
        assert_eq!(state.hottest_sensor.as_deref(), Some("gpu"));
        assert_eq!(state.throttled, Some(true));
        assert_eq!(state.cpu_mhz, Some(2000.0));
        assert_eq!(state.gpu_mhz, None);
        assert_eq!(state.power_mode.as_deref(), Some("15W, then MAXN"));
        let moment = at(1) + Duration::from_millis(300);
        let short = kept.state(moment, moment + Duration::from_millis(40));
        assert_eq!(short.unwrap().hottest_celsius, Some(50.0));
    }

    #[test]
    fn where_nothing_is_known_nothing_is_told() {
        let start = Instant::now();
        let mut kept = Conditions::new(Duration::from_secs(1));
        assert_eq!(kept.state(start, start + Duration::from_secs(1)), None);
        for i in 0..100 {
            kept.push(start + Duration::from_secs(i), Condition::default());
        }
        assert!(kept.kept.len() <= 2);
        assert_eq!(kept.state(start, start + Duration::from_secs(99)), None);
    }

    #[test]
    fn two_sources_tell_the_hotter_sensor_and_throttling_by_either() {
        let one = condition("cpu", 50.0, false, 1000.0, "15W");
        let two = condition("gpu", 60.0, true, 2000.0, "MAXN");
        let both = one.and(two);
        assert_eq!(both.hottest, Some(("gpu".into(), 60.0)));
        assert_eq!((both.throttled, both.cpu_mhz), (Some(true), Some(1000.0)));
        assert_eq!(both.mode.as_deref(), Some("15W"));
    }
}
