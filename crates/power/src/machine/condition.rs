//! The board's condition: two sources of the same moment combined, and a period summed.

use albireo_wire::BoardState;

/// The most power modes that one sum lists.
const MOST_MODES: usize = 8;

/// Combines two sources of the same moment: the hotter sensor, throttling by either, the busier GPU, and `one` first for
/// the rest.
pub(crate) fn combined(one: BoardState, other: BoardState) -> BoardState {
    let (hottest_celsius, hottest_sensor) = if other.hottest_celsius > one.hottest_celsius {
        (other.hottest_celsius, other.hottest_sensor)
    } else {
        (one.hottest_celsius, one.hottest_sensor)
    };
    BoardState {
        power_mode: one.power_mode.or(other.power_mode),
        hottest_celsius,
        hottest_sensor,
        // Unknown is the least, then false.
        throttled: one.throttled.max(other.throttled),
        cpu_mhz: one.cpu_mhz.or(other.cpu_mhz),
        gpu_mhz: one.gpu_mhz.or(other.gpu_mhz),
        gpu_utilisation: match (one.gpu_utilisation, other.gpu_utilisation) {
            (Some(one), Some(other)) => Some(one.max(other)),
            (one, other) => one.or(other),
        },
    }
}

/// The sum of successive conditions.
#[derive(Clone, Debug, Default)]
pub(crate) struct ConditionSum {
    /// The hottest sensor, and any throttling.
    worst: BoardState,
    modes: Vec<String>,
    cpu_mhz: Mean,
    gpu_mhz: Mean,
    gpu_utilisation: Mean,
}

impl ConditionSum {
    /// Adds a condition that is later than all before.
    pub(crate) fn add(&mut self, condition: &BoardState) {
        self.worst = combined(std::mem::take(&mut self.worst), condition.clone());
        if let Some(mode) = &condition.power_mode
            && self.modes.last() != Some(mode)
            && self.modes.len() < MOST_MODES
        {
            self.modes.push(mode.clone());
        }
        self.cpu_mhz.add(condition.cpu_mhz);
        self.gpu_mhz.add(condition.gpu_mhz);
        self.gpu_utilisation.add(condition.gpu_utilisation);
    }

    /// The board's state over the whole period; `None` if nothing is known.
    pub(crate) fn state(&self) -> Option<BoardState> {
        let has_modes = !self.modes.is_empty();
        let state = BoardState {
            power_mode: has_modes.then(|| self.modes.join(", then ")),
            cpu_mhz: self.cpu_mhz.value(),
            gpu_mhz: self.gpu_mhz.value(),
            gpu_utilisation: self.gpu_utilisation.value(),
            ..self.worst.clone()
        };
        if state == BoardState::default() {
            return None;
        }
        Some(state)
    }
}

/// The mean of the known values.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    pub(crate) fn add(&mut self, value: Option<f64>) {
        if let Some(value) = value {
            self.sum += value;
            self.count += 1.0;
        }
    }

    pub(crate) fn value(self) -> Option<f64> {
        if self.count == 0.0 {
            return None;
        }
        Some(self.sum / self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn condition(sensor: &str, celsius: f64, throttled: bool, mhz: f64, mode: &str) -> BoardState {
        BoardState {
            power_mode: Some(mode.to_owned()),
            hottest_celsius: Some(celsius),
            hottest_sensor: Some(sensor.to_owned()),
            throttled: Some(throttled),
            cpu_mhz: Some(mhz),
            gpu_mhz: None,
            gpu_utilisation: None,
        }
    }

    #[test]
    fn a_span_has_the_highest_temperature_any_throttling_and_the_mean_clock() {
        let mut sum = ConditionSum::default();
        sum.add(&BoardState::default());
        assert_eq!(sum.state(), None);
        sum.add(&condition("cpu", 50.0, false, 1000.0, "15W"));
        sum.add(&condition("gpu", 70.0, true, 2000.0, "MAXN"));
        sum.add(&condition("cpu", 60.0, false, 3000.0, "MAXN"));
        let expected = condition("gpu", 70.0, true, 2000.0, "15W, then MAXN");
        assert_eq!(sum.state(), Some(expected));
    }

    #[test]
    fn the_gpu_was_as_busy_as_its_busiest_card_on_average_and_unknown_moments_count_for_nothing() {
        let busy = |share| BoardState {
            gpu_utilisation: share,
            ..BoardState::default()
        };
        let mut sum = ConditionSum::default();
        for (one, other) in [
            (Some(0.2), Some(0.6)),
            (None, None),
            (Some(0.0), None),
            (None, Some(0.3)),
        ] {
            sum.add(&combined(busy(one), busy(other)));
        }
        let mean = sum.state().unwrap().gpu_utilisation.unwrap();
        assert!((mean - 0.3).abs() < 1e-12, "{mean}");
    }

    #[test]
    fn two_sources_combine_to_the_hotter_sensor_and_any_throttling() {
        let one = condition("cpu", 50.0, false, 1000.0, "15W");
        let both = combined(one, condition("gpu", 60.0, true, 2000.0, "MAXN"));
        assert_eq!(both, condition("gpu", 60.0, true, 1000.0, "15W"));
    }
}
