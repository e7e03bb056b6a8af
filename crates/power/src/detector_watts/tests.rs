//! Tests of the learnt detector watts, on simulated machines of known power.

use super::*;
use crate::reading::{Reading, Value};

/// A machine that draws `idle` watts at a given time and `busy` watts more while its detector runs. Calls last `call`
/// and start at multiples of `every` if `runs` returns `true`. [`learn`](Self::learn) returns the watts learnt in
/// `seconds`.
struct Machine {
    idle: fn(f64) -> f64,
    busy: f64,
    call: Duration,
    every: Duration,
    interval: Duration,
}

impl Machine {
    fn learn(&self, seconds: u64, runs: impl Fn(u64) -> bool) -> Option<f64> {
        let start = Instant::now();
        let mut history = History::new(self.interval);
        let mut learnt = DetectorWatts::new(self.interval);
        let step = Duration::from_millis(1);
        let (mut at, mut joules, mut running) = (Duration::ZERO, 0.0, Duration::ZERO);
        while at < Duration::from_secs(seconds) {
            let slot = (at.as_millis() / self.every.as_millis()) as u64;
            if at.as_millis().is_multiple_of(self.every.as_millis()) && runs(slot) {
                running = self.call;
            }
            let watts = (self.idle)(at.as_secs_f64());
            joules += watts * step.as_secs_f64();
            if !running.is_zero() {
                joules += self.busy * step.as_secs_f64();
                running -= step;
            }
            at += step;
            if running.is_zero()
                && (at.as_millis() % self.every.as_millis()) == self.call.as_millis()
                && runs(slot)
            {
                learnt.called(start + at, self.call);
            }
            if at.as_millis().is_multiple_of(self.interval.as_millis()) {
                let reading = Reading {
                    at: None,
                    values: [Some(Value::Counter(joules)), None, None, None],
                    total_from: "test".into(),
                    rails: Vec::new(),
                };
                history.add(start + at, &reading, |_, _| Vec::new());
                learnt.learn(&history);
            }
        }
        learnt.watts()
    }
}

/// A call rate that changes every 40 slots.
fn varied(slot: u64) -> bool {
    let lately = slot / 40 % 7;
    slot % 10 < 2 + lately
}

const MACHINE: Machine = Machine {
    idle: |_| 60.0,
    busy: 10.0,
    call: Duration::from_millis(40),
    every: Duration::from_millis(100),
    interval: Duration::from_millis(100),
};

#[test]
fn detector_watts_are_learnt_within_80_seconds_and_later_beside_slow_changes_or_with_slow_runs() {
    let beside_slow_changes = Machine {
        idle: |t| 60.0 + 20.0 * (t / 600.0).sin(),
        ..MACHINE
    };
    let with_slow_runs = Machine {
        call: Duration::from_millis(265),
        every: Duration::from_millis(400),
        interval: Duration::from_millis(1000),
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
fn a_constant_call_rate_yields_no_estimate() {
    assert_eq!(MACHINE.learn(300, |_| true), None);
    assert_eq!(MACHINE.learn(300, |slot| slot.is_multiple_of(2)), None);
    assert_eq!(MACHINE.learn(300, |_| false), None);
}

#[test]
fn a_detector_hidden_by_other_loads_yields_no_estimate() {
    let machine = Machine {
        idle: |t| if (t * 0.37).fract() < 0.5 { 30.0 } else { 90.0 },
        busy: 1.0,
        ..MACHINE
    };
    assert_eq!(machine.learn(600, varied), None);
}
