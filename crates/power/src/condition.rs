//! The board's condition, at one moment and over a period: temperature, throttling, clocks, power mode.

use albireo_wire::BoardState;
use std::sync::Arc;

/// The most power modes that one sum lists.
const MOST_MODES: usize = 8;

/// The board's condition at one moment, as far as it is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Condition {
    /// The hottest sensor and its temperature, °C.
    pub hottest: Option<(Arc<str>, f64)>,
    /// True if heat, current or power limits the clocks.
    pub throttled: Option<bool>,
    /// Mean clock of the online CPU cores, MHz.
    pub cpu_mhz: Option<f64>,
    /// GPU clock, MHz.
    pub gpu_mhz: Option<f64>,
    /// Power mode.
    pub mode: Option<Arc<str>>,
}

type Hottest = Option<(Arc<str>, f64)>;

fn hotter(one: Hottest, other: Hottest) -> Hottest {
    let both = other.into_iter().chain(one);
    both.max_by(|a, b| a.1.total_cmp(&b.1))
}

impl Condition {
    /// Combines two sources of the same moment: the hotter sensor, throttling by either, and `self` first for the rest.
    pub(crate) fn and(self, other: Self) -> Self {
        Self {
            hottest: hotter(self.hottest, other.hottest),
            throttled: self.throttled.max(other.throttled),
            cpu_mhz: self.cpu_mhz.or(other.cpu_mhz),
            gpu_mhz: self.gpu_mhz.or(other.gpu_mhz),
            mode: self.mode.or(other.mode),
        }
    }
}

/// The sum of successive conditions.
#[derive(Clone, Debug, Default)]
pub(crate) struct ConditionSum {
    hottest: Hottest,
    throttled: Option<bool>,
    modes: Vec<Arc<str>>,
    cpu_mhz: Mean,
    gpu_mhz: Mean,
}

impl ConditionSum {
    /// Adds a condition that is later than all before.
    pub(crate) fn add(&mut self, condition: &Condition) {
        self.hottest = hotter(self.hottest.take(), condition.hottest.clone());
        self.throttled = self.throttled.max(condition.throttled);
        if let Some(mode) = &condition.mode
            && self.modes.last() != Some(mode)
            && self.modes.len() < MOST_MODES
        {
            self.modes.push(Arc::clone(mode));
        }
        self.cpu_mhz.add(condition.cpu_mhz);
        self.gpu_mhz.add(condition.gpu_mhz);
    }

    /// The board's state; `None` if nothing is known.
    pub(crate) fn state(&self) -> Option<BoardState> {
        let hottest = self.hottest.as_ref();
        let state = BoardState {
            power_mode: (!self.modes.is_empty()).then(|| self.modes.join(", then ")),
            hottest_celsius: hottest.map(|(_, celsius)| *celsius),
            hottest_sensor: hottest.map(|(sensor, _)| sensor.to_string()),
            throttled: self.throttled,
            cpu_mhz: self.cpu_mhz.value(),
            gpu_mhz: self.gpu_mhz.value(),
        };
        (state != BoardState::default()).then_some(state)
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: Option<f64>) {
        self.sum += value.unwrap_or_default();
        self.count += f64::from(u8::from(value.is_some()));
    }

    fn value(self) -> Option<f64> {
        (self.count > 0.0).then(|| self.sum / self.count)
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
    fn a_span_has_the_highest_temperature_any_throttling_and_the_mean_clock() {
        let mut sum = ConditionSum::default();
        sum.add(&Condition::default());
        assert_eq!(sum.state(), None);
        sum.add(&condition("cpu", 50.0, false, 1000.0, "15W"));
        sum.add(&condition("gpu", 70.0, true, 2000.0, "MAXN"));
        sum.add(&condition("cpu", 60.0, false, 3000.0, "MAXN"));
        let expected = BoardState {
            power_mode: Some("15W, then MAXN".to_owned()),
            hottest_celsius: Some(70.0),
            hottest_sensor: Some("gpu".to_owned()),
            throttled: Some(true),
            cpu_mhz: Some(2000.0),
            gpu_mhz: None,
        };
        assert_eq!(sum.state(), Some(expected));
    }

    #[test]
    fn two_sources_combine_to_the_hotter_sensor_and_any_throttling() {
        let one = condition("cpu", 50.0, false, 1000.0, "15W");
        let both = one.and(condition("gpu", 60.0, true, 2000.0, "MAXN"));
        assert_eq!(both, condition("gpu", 60.0, true, 1000.0, "15W"));
    }
}
