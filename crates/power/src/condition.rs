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

/// How long conditions are kept.
const KEEP: Duration = Duration::from_secs(60);

/// Power modes that one span tells of.
const MOST_MODES: usize = 8;

/// Conditions of the last minute, oldest first.
#[derive(Debug, Default)]
pub(super) struct Conditions {
    kept: VecDeque<(Instant, Condition)>,
}

impl Conditions {
    /// Adds a condition and gives those that are too old to be kept.
    pub(super) fn push(&mut self, at: Instant, condition: Condition) -> Vec<(Instant, Condition)> {
        self.kept.push_back((at, condition));
        let young =
            |(first, _): &(Instant, Condition)| at.saturating_duration_since(*first) <= KEEP;
        let old = self.kept.partition_point(|entry| !young(entry));
        self.kept.drain(..old).collect()
    }

    /// Adds the kept conditions of `[start, end]` to `sum`; if that has none then, the last before `end`, so that
    /// a span shorter than the time between two conditions has one.
    pub(super) fn add_to(&self, sum: &mut ConditionSum, start: Instant, end: Instant) {
        let last = self.kept.partition_point(|(at, _)| *at <= end);
        let first = self.kept.partition_point(|(at, _)| *at < start);
        let first = if sum.count == 0 {
            first.min(last.saturating_sub(1))
        } else {
            first.min(last)
        };
        for (_, condition) in self.kept.range(first..last) {
            sum.add(condition);
        }
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.kept.len()
    }
}

/// What a span tells of the board, condition by condition.
#[derive(Clone, Debug, Default)]
pub(super) struct ConditionSum {
    count: u64,
    hottest: Option<(Arc<str>, f64)>,
    throttled: Option<bool>,
    modes: Vec<Arc<str>>,
    cpu: Mean,
    gpu: Mean,
}

impl ConditionSum {
    /// Adds a condition later than all before.
    pub(super) fn add(&mut self, condition: &Condition) {
        self.count += 1;
        if let Some((sensor, celsius)) = &condition.hottest {
            self.add_hottest(sensor, *celsius);
        }
        if let Some(throttled) = condition.throttled {
            self.throttled = Some(throttled || self.throttled.unwrap_or(false));
        }
        if let Some(mode) = &condition.mode {
            self.add_mode(mode);
        }
        self.cpu.add(condition.cpu_mhz);
        self.gpu.add(condition.gpu_mhz);
    }

    /// Adds what was noted after this.
    pub(super) fn append(&mut self, later: Self) {
        self.count += later.count;
        if let Some((sensor, celsius)) = &later.hottest {
            self.add_hottest(sensor, *celsius);
        }
        if let Some(throttled) = later.throttled {
            self.throttled = Some(throttled || self.throttled.unwrap_or(false));
        }
        later.modes.iter().for_each(|mode| self.add_mode(mode));
        self.cpu.append(&later.cpu);
        self.gpu.append(&later.gpu);
    }

    fn add_hottest(&mut self, sensor: &Arc<str>, celsius: f64) {
        if self.hottest.as_ref().is_none_or(|(_, c)| celsius > *c) {
            self.hottest = Some((Arc::clone(sensor), celsius));
        }
    }

    fn add_mode(&mut self, mode: &Arc<str>) {
        if self.modes.last() != Some(mode) && self.modes.len() < MOST_MODES {
            self.modes.push(Arc::clone(mode));
        }
    }

    /// The state; `None` where nothing is known.
    pub(super) fn state(&self) -> Option<BoardState> {
        let state = BoardState {
            power_mode: (!self.modes.is_empty()).then(|| self.modes.join(", then ")),
            hottest_celsius: self.hottest.as_ref().map(|(_, celsius)| *celsius),
            hottest_sensor: self.hottest.as_ref().map(|(sensor, _)| sensor.to_string()),
            throttled: self.throttled,
            cpu_mhz: self.cpu.value(),
            gpu_mhz: self.gpu.value(),
        };
        (state != BoardState::default()).then_some(state)
    }
}

#[derive(Clone, Debug, Default)]
struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    fn add(&mut self, value: Option<f64>) {
        if let Some(value) = value {
            self.sum += value;
            self.count += 1;
        }
    }

    fn append(&mut self, other: &Self) {
        self.sum += other.sum;
        self.count += other.count;
    }

    fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
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
        let mut kept = Conditions::default();
        kept.push(at(0), condition("cpu", 90.0, true, 9999.0, "15W"));
        kept.push(at(1), condition("cpu", 50.0, false, 1000.0, "15W"));
        kept.push(at(2), condition("gpu", 70.0, true, 2000.0, "MAXN"));
        kept.push(at(3), condition("cpu", 60.0, false, 3000.0, "MAXN"));
        let state = |start, end| {
            let mut sum = ConditionSum::default();
            kept.add_to(&mut sum, start, end);
            sum.state()
        };
        let found = state(at(1), at(3)).unwrap();
        assert_eq!(found.hottest_celsius, Some(70.0));
        assert_eq!(found.hottest_sensor.as_deref(), Some("gpu"));
        assert_eq!(found.throttled, Some(true));
        assert_eq!(found.cpu_mhz, Some(2000.0));
        assert_eq!(found.gpu_mhz, None);
        assert_eq!(found.power_mode.as_deref(), Some("15W, then MAXN"));
        let moment = at(1) + Duration::from_millis(300);
        let short = state(moment, moment + Duration::from_millis(40));
        assert_eq!(short.unwrap().hottest_celsius, Some(50.0));
    }

    #[test]
    fn where_nothing_is_known_nothing_is_told_and_what_is_old_is_handed_out() {
        let start = Instant::now();
        let mut kept = Conditions::default();
        let mut old = 0;
        for i in 0..100 {
            let at = start + Duration::from_secs(i);
            old += kept.push(at, Condition::default()).len();
        }
        assert_eq!((kept.len(), old), (61, 39));
        let mut sum = ConditionSum::default();
        kept.add_to(&mut sum, start, start + Duration::from_secs(99));
        assert_eq!(sum.state(), None);
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
