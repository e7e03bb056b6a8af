use super::*;
use crate::reading::Value;
use crate::tests::{ms, reading};

/// A machine whose power follows its detector. Its time is cut into slots, in each of which the detector runs once or not.
struct Machine {
    /// Watts without the detector, at a time in seconds.
    idle: fn(f64) -> f64,
    /// Watts that the running detector adds.
    busy: f64,
    /// The length of a run, milliseconds.
    call: u64,
    /// The length of a slot, milliseconds.
    every: u64,
    /// The time between two samples, milliseconds.
    interval: u64,
}

impl Machine {
    fn learn(&self, seconds: u64, runs: impl Fn(u64) -> bool) -> Option<f64> {
        let start = Instant::now();
        let interval = ms(self.interval);
        let mut history = History::new(interval);
        let mut learnt = DetectorWatts::new(interval);
        let mut joules = 0.0;
        for now in 0..1000 * seconds {
            let slot = now / self.every;
            let phase = now % self.every;
            let is_running = phase < self.call && runs(slot);
            joules += 1e-3 * (self.idle)(now as f64 / 1e3);
            joules += if is_running { 1e-3 * self.busy } else { 0.0 };
            let end = start + ms(now + 1);
            if is_running && phase + 1 == self.call {
                learnt.called(end, ms(self.call));
            }
            if (now + 1).is_multiple_of(self.interval) {
                history.add(end, &reading(Value::Counter(joules)), |_, _| Vec::new());
                learnt.learn(&history);
            }
        }
        learnt.watts()
    }
}

/// Of ten slots the detector runs in two to eight; the number changes every forty slots.
fn varied(slot: u64) -> bool {
    let more = slot / 40 % 7;
    slot % 10 < 2 + more
}

const MACHINE: Machine = Machine {
    idle: |_| 60.0,
    busy: 10.0,
    call: 40,
    every: 100,
    interval: 100,
};

#[test]
fn detector_watts_are_learnt_within_80_seconds_and_later_beside_slow_changes_or_with_slow_runs() {
    let beside_slow_changes = Machine {
        idle: |t| 60.0 + 20.0 * (t / 600.0).sin(),
        ..MACHINE
    };
    let with_slow_runs = Machine {
        call: 265,
        every: 400,
        interval: 1000,
        ..MACHINE
    };
    for (machine, seconds, most) in [
        (MACHINE, 80, 0.03),
        (beside_slow_changes, 1200, 0.1),
        (with_slow_runs, 1200, 0.1),
    ] {
        let found = machine.learn(seconds, varied).unwrap();
        assert!((found / 10.0 - 1.0).abs() < most, "{found} in {seconds} s");
    }
}

#[test]
fn a_constant_call_rate_or_a_detector_hidden_by_other_loads_yields_no_estimate() {
    assert_eq!(MACHINE.learn(300, |_| true), None);
    assert_eq!(MACHINE.learn(300, |slot| slot.is_multiple_of(2)), None);
    assert_eq!(MACHINE.learn(300, |_| false), None);
    let with_other_loads = Machine {
        idle: |t| if (t * 0.37).fract() < 0.5 { 30.0 } else { 90.0 },
        busy: 1.0,
        ..MACHINE
    };
    assert_eq!(with_other_loads.learn(600, varied), None);
}
