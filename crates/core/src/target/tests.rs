//! Simulates a node by a few straight lines, second by second in virtual time.

use super::*;
use crate::audit::tests::add_crowd;
use crate::policy::tests::random;
use crate::policy::{Albireo, Ctd, ExpectedLoss};
use proptest::prelude::*;

const RANGE: ThresholdRange = ThresholdRange {
    least: 0.05,
    most: 2.0,
};

/// A camera with a detector that consumes 9 W when it is always busy, on a board that consumes 4 W.
struct Plant {
    rate: u64,
    /// Share of frames with the detector at a threshold of 0.3.
    busy: f64,
    steepness: f64,
    detector_ms: f64,
    /// The true recall at a threshold of 0.3, if frames are audited. It falls as the threshold rises.
    recall: Option<f64>,
    /// In so many of ten seconds the audit is missed.
    missed_of_ten: u64,
    played: u64,
    random: Box<dyn FnMut() -> f64>,
    /// Frames until the next detector call.
    until_call: f64,
}

impl Plant {
    fn new(seed: u64) -> Self {
        Self {
            rate: 15,
            busy: 0.6,
            steepness: 0.22,
            detector_ms: 40.0,
            recall: None,
            missed_of_ten: 0,
            played: 0,
            random: Box::new(random(seed)),
            until_call: 1.0,
        }
    }

    /// One audited frame of five boxes every three seconds.
    fn audited(&mut self, recall: f64) -> AuditSums {
        let mut sums = AuditSums::default();
        if (self.random)() < 1.0 / 3.0 {
            let shown = (0..5).filter(|_| (self.random)() < recall).count();
            if self.played % 10 < self.missed_of_ten {
                sums.add_missed(5);
            } else {
                add_crowd(&mut sums, 5, shown);
            }
        }
        sums
    }

    /// Plays a second with the threshold at this value. The pauses between calls vary as they do on roads.
    fn second(&mut self, threshold: f64) -> Measured {
        let above = (threshold / 0.3).ln();
        let recall = self.recall.map(|recall| recall - 0.05 * above);
        let audit = recall.map(|recall| self.audited(recall));
        self.played += 1;
        let share = (self.busy - self.steepness * above).clamp(0.04, 1.0);
        let mut calls = 0;
        for _ in 0..self.rate {
            self.until_call -= 1.0;
            if self.until_call <= 0.0 {
                calls += 1;
                self.until_call += 1.0 / share * (0.6 + 0.8 * (self.random)());
            }
        }
        let busy = (calls as f64 * self.detector_ms / 1000.0).min(1.0);
        let noise = 1.0 + 0.04 * ((self.random)() - 0.5);
        Measured {
            seconds: 1.0,
            frames: self.rate,
            skipped: self.rate - calls,
            watts: Some((4.0 + 9.0 * busy) * noise),
            audit: audit.unwrap_or_default(),
        }
    }
}

/// Lets `seconds` pass; returns every state.
fn run(controller: &mut TargetController, plant: &mut Plant, seconds: u32) -> Vec<TargetState> {
    (0..seconds)
        .map(|_| controller.step(&plant.second(controller.threshold())))
        .collect()
}

/// Asserts that after a minute the value stays within 10 % of the target, and its mean is within 3 %.
fn settles(controller: &mut TargetController, plant: &mut Plant, what: &str) {
    let what = format!("{}, {what}", controller.target());
    let wanted = controller.target().value();
    run(controller, plant, 60);
    let states = run(controller, plant, 240);
    for (second, state) in states.iter().enumerate() {
        let off = state.actual.unwrap() / wanted - 1.0;
        assert!(off.abs() <= 0.10, "{what}: {off} at {second} s: {state:?}");
    }
    let mean = states.iter().filter_map(|state| state.actual).sum::<f64>() / 240.0;
    assert!((mean / wanted - 1.0).abs() < 0.03, "{what}: mean {mean}");
    let held = states.iter().filter(|state| state.status == TargetStatus::Held);
    assert!(held.count() > 180, "{what}");
}

/// Targets that can be met in all the scenes below, with 15 frames per second, 40 ms and at most 13 W.
const LOAD_TARGETS: [Target; 2] = [Target::SkipRate(0.5), Target::Watts(6.4)];

#[test]
fn load_targets_settle_within_a_minute_of_a_step_of_the_scene_and_of_the_detector() {
    for (target, seed) in LOAD_TARGETS.into_iter().zip(1..) {
        let mut plant = Plant::new(seed);
        // Starting from the far end of the range.
        let mut controller = TargetController::new(target, RANGE, 0.05).unwrap();
        settles(&mut controller, &mut plant, "at the start");
        let scenes = [
            (0.75, 40.0, 15, "a dense scene"),
            (0.45, 40.0, 15, "an empty scene"),
            (0.45, 48.0, 15, "a slow detector"),
            (0.6, 30.0, 15, "a fast detector"),
            (0.6, 30.0, 20, "more frames"),
        ];
        for (busy, detector_ms, rate, what) in scenes {
            plant.busy = busy;
            plant.detector_ms = detector_ms;
            plant.rate = rate;
            settles(&mut controller, &mut plant, what);
        }
    }
}

#[test]
fn three_frames_per_second_settle_slower_without_oscillation() {
    let mut plant = Plant::new(71);
    plant.rate = 3;
    let mut controller = TargetController::new(Target::SkipRate(0.5), RANGE, 0.05).unwrap();
    for busy in [0.6, 0.75] {
        plant.busy = busy;
        run(&mut controller, &mut plant, 240);
        settles(&mut controller, &mut plant, "at 3 frames a second");
    }
}

#[test]
fn a_threshold_with_twice_or_half_the_effect_settles_too() {
    for (steepness, seed) in [(0.44, 11), (0.12, 12)] {
        for target in LOAD_TARGETS {
            let mut plant = Plant::new(seed);
            plant.steepness = steepness;
            let mut controller = TargetController::new(target, RANGE, 0.3).unwrap();
            // The flat scene takes longer.
            run(&mut controller, &mut plant, 60);
            settles(&mut controller, &mut plant, "another steepness");
        }
    }
}

#[test]
fn an_overload_is_reported_counted_and_left_within_a_minute_of_its_end() {
    let target = Target::Watts(5.8);
    let mut plant = Plant::new(21);
    let mut controller = TargetController::new(target, RANGE, 0.3).unwrap();
    settles(&mut controller, &mut plant, "before");
    // Throttling makes the detector six times slower, and a crowd comes.
    plant.detector_ms = 240.0;
    plant.busy = 1.0;
    let states = run(&mut controller, &mut plant, 600);
    let last = states.last().unwrap();
    assert_eq!(last.status, TargetStatus::CannotBeMet, "{target}: {last:?}");
    assert!((last.threshold - RANGE.most).abs() < 1e-9);
    assert_eq!(last.unmet, 1);
    assert!((450.0..600.0).contains(&last.unmet_s), "{last:?}");
    // No integral has wound up, however long it lasted.
    plant.detector_ms = 40.0;
    plant.busy = 0.6;
    settles(&mut controller, &mut plant, "after");
    assert_eq!(run(&mut controller, &mut plant, 1)[0].unmet, 1);
}

#[test]
fn a_load_below_the_target_at_the_accurate_end_counts_as_met() {
    let mut plant = Plant::new(31);
    plant.busy = 0.0;
    let mut controller = TargetController::new(Target::Watts(7.5), RANGE, 0.3).unwrap();
    let last = *run(&mut controller, &mut plant, 120).last().unwrap();
    assert_eq!(last.status, TargetStatus::MoreThanKept, "{last:?}");
    assert!((last.threshold - RANGE.least).abs() < 1e-9);
    assert_eq!((last.unmet, last.unmet_s), (0, 0.0));
}

#[test]
fn a_step_of_a_minute_moves_the_threshold_no_further_than_one_of_two_seconds() {
    let turned = |seconds: f64| {
        let mut plant = Plant::new(61);
        let mut controller = TargetController::new(Target::SkipRate(0.8), RANGE, 0.1).unwrap();
        run(&mut controller, &mut plant, 10);
        let before = controller.threshold();
        let last = plant.second(before);
        controller.step(&Measured { seconds, ..last });
        (controller.threshold() / before).ln()
    };
    let (short, long) = (turned(2.0), turned(60.0));
    assert!(short > 0.05, "{short}");
    assert!(long > 0.0 && long <= short, "{long} after {short}");
}

#[test]
fn a_restart_continues_from_the_stored_value() {
    for target in LOAD_TARGETS {
        let mut plant = Plant::new(41);
        let mut controller = TargetController::new(target, RANGE, 1.0).unwrap();
        settles(&mut controller, &mut plant, "before");
        let mut after = TargetController::new(target, RANGE, controller.threshold()).unwrap();
        let states = run(&mut after, &mut plant, 120);
        assert_eq!(states[0].status, TargetStatus::Measuring);
        for state in states.iter().skip(5) {
            let off = state.actual.unwrap() / target.value() - 1.0;
            assert!(off.abs() <= 0.10, "{target}: {state:?}");
        }
    }
}

#[test]
fn without_frames_or_power_the_threshold_rests_and_the_reason_is_reported() {
    let mut controller = TargetController::new(Target::Watts(6.0), RANGE, 0.3).unwrap();
    let mut plant = Plant::new(51);
    for _ in 0..30 {
        let measured = Measured {
            watts: None,
            ..plant.second(0.3)
        };
        assert_eq!(controller.step(&measured).status, TargetStatus::NoPower);
    }
    let silence = Measured {
        seconds: 1.0,
        watts: Some(4.0),
        ..Measured::default()
    };
    // Frames of the previous seconds stay in the window for a while.
    for _ in 0..61 {
        controller.step(&silence);
    }
    let threshold = controller.threshold();
    for _ in 0..30 {
        assert_eq!(controller.step(&silence).status, TargetStatus::NoFrames);
    }
    assert!((controller.threshold() - threshold).abs() < 1e-9);
}

#[test]
fn a_recall_target_pauses_while_more_than_a_fifth_of_the_audit_is_missed() {
    let mut plant = Plant::new(71);
    plant.recall = Some(0.99);
    plant.missed_of_ten = 4;
    let mut controller = TargetController::new(Target::Recall(0.85), RANGE, 0.3).unwrap();
    let before = controller.threshold();
    let states = run(&mut controller, &mut plant, 3600);
    assert_eq!(states.last().unwrap().status, TargetStatus::Measuring);
    assert_eq!(controller.threshold() / before, 1.0);
    plant.missed_of_ten = 0;
    run(&mut controller, &mut plant, 3600);
    let turned = controller.threshold() / before;
    assert!(turned > 1.5, "{turned}");
}

#[test]
fn the_lower_bound_of_recall_is_held_and_an_impossible_one_is_reported() {
    let target = Target::Recall(0.85);
    let mut plant = Plant::new(61);
    plant.recall = Some(0.90);
    let mut controller = TargetController::new(target, RANGE, 2.0).unwrap();
    let states = run(&mut controller, &mut plant, 3 * 3600);
    // After the first of three hours.
    let kept = &states[3600..];
    let of_truth = |state: &TargetState| 0.90 - 0.05 * (state.threshold / 0.3).ln();
    let mean = kept.iter().map(of_truth).sum::<f64>() / kept.len() as f64;
    assert!((0.85..0.90).contains(&mean), "{mean}");
    let below = kept.iter().filter(|state| of_truth(state) < 0.84).count();
    assert!(below < kept.len() / 10, "{below} of {}", kept.len());
    assert!(kept.last().unwrap().boxes.unwrap() > 100);

    plant.recall = Some(0.70);
    let states = run(&mut controller, &mut plant, 3 * 3600);
    let last = states.last().unwrap();
    assert_eq!(last.status, TargetStatus::CannotBeMet, "{last:?}");
    assert!((last.threshold - RANGE.least).abs() < 1e-9 && last.unmet_s > 3600.0);

    // Nothing is drawn any more: the status reports it, and the threshold stays.
    plant.recall = None;
    plant.busy = 0.3;
    let states = run(&mut controller, &mut plant, 701);
    assert_eq!(states[700].status, TargetStatus::NoAudit);
}

#[test]
fn impossible_targets_are_rejected_with_a_reason() {
    for wrong in [
        Target::SkipRate(1.0),
        Target::SkipRate(f64::NAN),
        Target::Recall(0.0),
        Target::Watts(-1.0),
        Target::Watts(f64::INFINITY),
    ] {
        assert!(wrong.check().is_err(), "{wrong:?}");
        assert!(TargetController::new(wrong, RANGE, 0.3).is_err());
    }
    let error = Target::SkipRate(3.0).check().unwrap_err();
    let expected = "`skip_rate` must be a number from 0.01 to 0.99, not 3";
    assert_eq!(error.to_string(), expected);
    for name in Target::NAMES {
        let target = Target::named(name, 0.5).unwrap();
        let text = serde_json::to_string(&target).unwrap();
        assert_eq!(text, format!("{{\"{name}\":0.5}}"));
        assert_eq!(serde_json::from_str::<Target>(&text).unwrap(), target);
        assert_eq!(target.name(), name);
    }
    assert_eq!(Target::named("speed", 1.0), None);
}

#[test]
fn the_default_range_costs_little_accuracy_and_other_thresholds_are_rejected() {
    let range = ThresholdRange::of("albireo", Some(&Albireo::THRESHOLD), None, None).unwrap();
    assert_eq!((range.least, range.most), (1.5e-4, 2e-3));
    let threshold = &ExpectedLoss::THRESHOLD;
    let range = ThresholdRange::of("expected-loss", Some(threshold), Some(0.1), Some(0.6)).unwrap();
    assert_eq!((range.least, range.most), (0.1, 0.6));
    for (least, most) in [(0.6, 0.1), (0.2, 0.2), (-1.0, 0.5), (0.1, 1e9)] {
        let range = ThresholdRange::of("expected-loss", Some(threshold), Some(least), Some(most));
        assert!(range.is_err(), "{least} {most}");
    }
    let refused = ThresholdRange::of("ctd", Some(&Ctd::THRESHOLD), None, None).unwrap_err();
    assert!(refused.to_string().contains("`ctd`"), "{refused}");
    let refused = ThresholdRange::of("vanilla", None, None, None).unwrap_err();
    let expected = "a target moves `u` or `lambda`, and policy `vanilla` has no threshold";
    assert_eq!(refused.to_string(), expected);
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        -1e3..1e6,
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(0.0)
    ]
}

proptest! {
    #[test]
    fn with_any_measurement_the_threshold_stays_in_its_range(
        steps in prop::collection::vec(
            (any_number(), any::<u32>(), any::<u32>(), prop::option::of(any_number())),
            1..40
        ),
        which in 0..3usize,
    ) {
        let target = Target::named(Target::NAMES[which], 0.5).unwrap();
        let mut controller = TargetController::new(target, RANGE, 0.3).unwrap();
        for (seconds, frames, skipped, watts) in steps {
            let state = controller.step(&Measured {
                seconds,
                frames: frames.into(),
                skipped: skipped.into(),
                watts,
                audit: AuditSums::default(),
            });
            let range = RANGE.least - 1e-9..=RANGE.most + 1e-9;
            prop_assert!(range.contains(&state.threshold), "{:?}", state);
        }
    }
}
