use super::*;
use crate::detection::ClassId;
use crate::geometry::{BoundingBox, PictureSize};
use crate::policy::{BoxSource, FrameEvidence, decide};
use proptest::prelude::*;

const PICTURE: PictureSize = PictureSize::new(1280, 720);

fn settings() -> ExpectedLossSettings {
    ExpectedLossSettings::default()
}

fn policy(lambda: f64) -> ExpectedLoss {
    ExpectedLoss::new(settings(), Trigger::ExpectedLoss { lambda }).unwrap()
}

fn scheduled(trigger: Trigger) -> ExpectedLoss {
    ExpectedLoss::new(settings(), trigger).unwrap()
}

fn detection(x: f64, y: f64, side: f64, confidence: f64) -> Detection {
    Detection {
        bounding_box: BoundingBox::new(x, y, side, side * 1.5),
        class: ClassId(2),
        confidence,
    }
}

/// Frame `frame` of a film: objects that pass at different speeds, one of them only now and then seen,
/// and long stretches of an empty road.
fn film(frame: u64) -> Vec<Detection> {
    let time = frame as f64;
    let mut seen = Vec::new();
    if frame % 80 < 50 {
        seen.push(detection(0.2 + 0.01 * (time % 80.0), 0.5, 0.08, 0.9));
        if frame % 7 != 3 {
            seen.push(detection(0.8 - 0.006 * (time % 80.0), 0.4, 0.05, 0.7));
        }
        if frame % 3 == 1 {
            seen.push(detection(0.5, 0.6 + 0.05 * (time * 0.9).sin(), 0.1, 0.4));
        }
    }
    seen
}

/// What a frame is given.
#[derive(Clone, Copy)]
struct World<'a> {
    step: u32,
    empty: Option<bool>,
    detections: Option<&'a [Detection]>,
}

fn frame(policy: &mut ExpectedLoss, world: World<'_>) -> Outcome {
    let mut outcome = Outcome::default();
    let head = FrameHead {
        index: 0,
        step: world.step,
        picture: PICTURE,
    };
    let mut known = FrameEvidence {
        empty: world.empty,
        grey: None,
        detections: world.detections,
    };
    let Ok(()) = decide(policy, head, &mut known, &mut outcome);
    outcome
}

/// A frame with everything at hand and a screen that never says "empty".
fn see(policy: &mut ExpectedLoss, detections: &[Detection]) -> Outcome {
    let world = World {
        step: 1,
        empty: Some(false),
        detections: Some(detections),
    };
    frame(policy, world)
}

fn records(policy: &ExpectedLoss) -> Vec<ObjectRecord> {
    let mut records = Vec::new();
    policy.objects(&mut |record| records.push(*record));
    records
}

fn skip_rate(policy: &mut ExpectedLoss, frames: u64) -> f64 {
    let skipped = (0..frames)
        .filter(|&index| see(policy, &film(index)).state.is_skipped())
        .count();
    skipped as f64 / frames as f64
}

#[test]
fn the_first_frame_calls_the_detector_even_if_its_first_answers_are_missing() {
    let mut policy = policy(100.0);
    let missing = World {
        step: 1,
        empty: Some(false),
        detections: None,
    };
    for _ in 0..2 {
        let outcome = frame(&mut policy, missing);
        assert_eq!((outcome.state, outcome.degraded), (FrameState::P, true));
    }
    let outcome = see(&mut policy, &film(0));
    assert_eq!((outcome.state, outcome.degraded), (FrameState::EI, false));
    assert_eq!(see(&mut policy, &film(1)).state, FrameState::P);
}

#[test]
fn a_higher_lambda_calls_the_detector_less_often() {
    let rates: Vec<_> = [0.0, 0.1, 0.5, 2.0, 100.0]
        .into_iter()
        .map(|lambda| skip_rate(&mut policy(lambda), 400))
        .collect();
    assert_eq!(rates[0], 0.0);
    assert!(rates.is_sorted_by(|a, b| a < b), "{rates:?}");
    // Only the longest pause is left: one frame of 15.
    assert!((rates[4] - 14.0 / 15.0).abs() < 0.01, "{rates:?}");
}

#[test]
fn a_fast_object_calls_the_detector_more_often_than_a_steady_one() {
    let rate = |amplitude: f64| {
        let mut policy = policy(0.5);
        let skipped = (0..200u32)
            .filter(|&index| {
                let x = 0.5 + amplitude * (f64::from(index) * 0.7).sin();
                see(&mut policy, &[detection(x, 0.5, 0.1, 0.9)])
                    .state
                    .is_skipped()
            })
            .count();
        skipped as f64 / 200.0
    };
    assert!(rate(0.0) > rate(0.08) + 0.1, "{} {}", rate(0.0), rate(0.08));
}

#[test]
fn a_knob_turned_takes_effect_with_the_next_frame() {
    let mut policy = policy(100.0);
    for index in 0..10 {
        see(&mut policy, &film(index));
    }
    assert_eq!(see(&mut policy, &film(10)).state, FrameState::P);
    policy.set_knob(0.0).unwrap();
    assert!(!see(&mut policy, &film(11)).state.is_skipped());
}

#[test]
fn a_screen_that_never_says_empty_changes_no_decision() {
    let mut with = policy(0.5);
    let mut without = policy(0.5);
    let mut screened = 0;
    for index in 0..400 {
        let a = see(&mut with, &film(index));
        let unscreened = World {
            step: 1,
            empty: None,
            detections: Some(&film(index)),
        };
        let b = frame(&mut without, unscreened);
        screened += u32::from(a.state == FrameState::EI);
        assert_eq!(a.state.is_skipped(), b.state.is_skipped(), "frame {index}");
        assert_eq!(a.boxes, b.boxes, "frame {index}");
        assert_ne!(b.state, FrameState::EI);
    }
    assert!(screened > 0);
}

#[test]
fn a_screen_that_says_empty_spares_the_detector_until_it_says_otherwise() {
    let mut policy = policy(0.0);
    let empty = World {
        step: 1,
        empty: Some(true),
        detections: Some(&[]),
    };
    for _ in 0..40 {
        assert_eq!(frame(&mut policy, empty).state, FrameState::E);
    }
    assert_eq!(see(&mut policy, &film(0)).state, FrameState::EI);
    // With an object in view the screen is not asked.
    let outcome = see(&mut policy, &film(1));
    assert_eq!(outcome.state, FrameState::I);
    // Without its verdict the detector is asked.
    let mut fresh = self::policy(0.0);
    let silent = World {
        empty: None,
        ..empty
    };
    assert_eq!(frame(&mut fresh, silent).state, FrameState::I);
}

#[test]
fn without_the_detector_boxes_are_predicted_and_no_miss_is_counted() {
    let mut policy = policy(0.0);
    for index in 0..10 {
        see(&mut policy, &film(index));
    }
    let before = records(&policy);
    let blind = World {
        step: 1,
        empty: None,
        detections: None,
    };
    for round in 0..20 {
        let outcome = frame(&mut policy, blind);
        assert_eq!((outcome.state, outcome.degraded), (FrameState::P, true));
        // Objects that leave the picture meanwhile are dropped; none appears.
        assert!(!outcome.boxes.is_empty(), "round {round}");
        assert!(outcome.boxes.len() <= before.len(), "round {round}");
        assert!(
            outcome
                .boxes
                .iter()
                .all(|b| b.source == BoxSource::Predicted)
        );
    }
    for after in records(&policy) {
        let before = before.iter().find(|before| before.id == after.id);
        assert_eq!(before.map(|before| before.misses), Some(after.misses));
    }
    // The blindness has an end: then nothing is known any more.
    for _ in 0..11 {
        frame(&mut policy, blind);
    }
    assert!(records(&policy).is_empty());
}

#[test]
fn a_missed_object_is_rescued_with_falling_confidence_and_removed_at_the_sixth_miss() {
    let mut policy = policy(0.0);
    for _ in 0..10 {
        see(&mut policy, &[detection(0.5, 0.5, 0.1, 0.9)]);
    }
    let mut last = 1.0;
    for _ in 0..5 {
        let outcome = see(&mut policy, &[]);
        assert_eq!(outcome.state, FrameState::AI);
        assert_eq!(outcome.boxes[0].source, BoxSource::Rescued);
        assert!(outcome.boxes[0].confidence < last * 0.76);
        last = outcome.boxes[0].confidence;
    }
    let outcome = see(&mut policy, &[]);
    assert_eq!((outcome.state, outcome.boxes.len()), (FrameState::I, 0));
}

#[test]
fn a_gap_predicts_as_many_single_frames_do() {
    for frames in [1, 2, 5, 14] {
        let mut single = policy(0.0);
        for index in 0..10 {
            see(&mut single, &film(index));
        }
        let mut gap = single.clone();
        // Nothing calls the detector but the longest pause.
        single.set_knob(100.0).unwrap();
        gap.set_knob(100.0).unwrap();
        for _ in 0..frames {
            assert_eq!(see(&mut single, &[]).state, FrameState::P);
        }
        let lost = World {
            step: frames,
            empty: None,
            detections: None,
        };
        assert_eq!(frame(&mut gap, lost).state, FrameState::P);
        assert_eq!(records(&single), records(&gap));
        assert_eq!(single.pause.frames, gap.pause.frames);
    }
}

#[test]
fn after_a_gap_beyond_all_prediction_the_objects_are_forgotten() {
    let mut policy = policy(100.0);
    see(&mut policy, &film(0));
    let gap = World {
        step: u32::MAX,
        empty: Some(false),
        detections: Some(&[]),
    };
    assert_eq!(frame(&mut policy, gap).state, FrameState::EI);
    assert!(records(&policy).is_empty());
}

#[test]
fn a_picture_of_another_shape_forgets_the_objects_and_one_of_more_pixels_does_not() {
    let mut policy = policy(0.0);
    see(&mut policy, &film(0));
    let head = |width, height| FrameHead {
        index: 0,
        step: 1,
        picture: PictureSize::new(width, height),
    };
    policy.begin(head(2560, 1440));
    assert_eq!(records(&policy).len(), film(0).len());
    policy.begin(head(640, 480));
    assert!(records(&policy).is_empty());
}

#[test]
fn a_fixed_schedule_calls_on_one_frame_of_n() {
    let mut policy = scheduled(Trigger::FixedSkip { n: 3.0 });
    let called: Vec<_> = (0..12)
        .map(|index| !see(&mut policy, &film(index)).state.is_skipped())
        .collect();
    let expected: Vec<_> = (0..12).map(|index| index % 3 == 0).collect();
    assert_eq!(called, expected);
    assert_eq!(policy.name(), "fixed-skip-in-tracker");
    assert!(policy.set_knob(2.0).is_ok());
    for n in [0.0, 0.5, 1e9, f64::NAN] {
        let wrong = Trigger::FixedSkip { n };
        assert!(ExpectedLoss::new(settings(), wrong).is_err(), "{n}");
    }
}

#[test]
fn an_even_schedule_meets_its_rate_and_spaces_its_calls_evenly() {
    for skip in [0.0, 0.1, 0.5, 0.62, 0.9, 0.95] {
        let mut policy = scheduled(Trigger::Even { skip_rate: skip });
        let mut calls = Vec::new();
        for index in 0..1000 {
            if !see(&mut policy, &film(index)).state.is_skipped() {
                calls.push(index);
            }
        }
        let wanted = 1000.0 * (1.0 - skip);
        assert!(
            (calls.len() as f64 - wanted).abs() <= 1.0,
            "{skip}: {}",
            calls.len()
        );
        let gaps: Vec<_> = calls.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let (least, most) = (gaps.iter().min().unwrap(), gaps.iter().max().unwrap());
        assert!(most - least <= 1, "{skip}: {least} to {most}");
    }
}

#[test]
fn a_schedule_is_back_in_step_after_a_gap() {
    let mut policy = scheduled(Trigger::FixedSkip { n: 4.0 });
    let gap = |step| World {
        step,
        empty: Some(false),
        detections: Some(&[]),
    };
    let called: Vec<_> = [1, 1, 9, 1, 1, 2, 1, 3]
        .into_iter()
        .map(|step| !frame(&mut policy, gap(step)).state.is_skipped())
        .collect();
    // At frames 0, 1, 10, 11, 12, 14, 15 and 18 of a schedule that has 0, 4, 8, 12 and 16.
    let expected = [true, false, true, false, true, false, false, true];
    assert_eq!(called, expected);
}

/// Numbers a broken detector may give, among good ones.
fn numbers() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => 0.0..1.0,
        1 => prop::sample::select(vec![
            f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, -1.0, 1.0, 1e-300, 5e-324, 1e-9,
            999.0, 1e3, 1e300, -1e3,
        ]),
    ]
}

fn hostile() -> impl Strategy<Value = Vec<Detection>> {
    let detection = (numbers(), numbers(), numbers(), numbers(), numbers()).prop_map(
        |(x, y, width, height, confidence)| Detection {
            bounding_box: BoundingBox::new(x, y, width, height),
            class: ClassId(0),
            confidence,
        },
    );
    prop::collection::vec(detection, 0..6)
}

/// A frame: lost frames before it, and what the detector would say, if it says anything.
fn streams() -> impl Strategy<Value = Vec<(u32, Option<Vec<Detection>>)>> {
    let step = prop_oneof![8 => Just(1u32), 2 => 1..20u32, 1 => Just(u32::MAX)];
    prop::collection::vec((step, prop::option::weighted(0.9, hostile())), 1..60)
}

proptest! {
    #[test]
    fn whatever_the_detector_says_numbers_stay_finite_and_boxes_inside(
        stream in streams(),
        lambda in 0.0..2.0f64,
    ) {
        let mut policy = policy(lambda);
        for (step, detections) in &stream {
            let world = World { step: *step, empty: Some(false), detections: detections.as_deref() };
            let outcome = frame(&mut policy, world);
            prop_assert!(policy.weight().is_finite());
            prop_assert!(policy.crowd.is_finite() && policy.crowd >= 0.0);
            prop_assert!(outcome.tau_max.is_none_or(f64::is_finite));
            for output in &outcome.boxes {
                let corners = output.bounding_box.corners();
                prop_assert!(output.bounding_box.is_finite());
                prop_assert!(corners.x1 > -1e-12 && corners.x2 < 1.0 + 1e-12);
                prop_assert!(corners.y1 > -1e-12 && corners.y2 < 1.0 + 1e-12);
                prop_assert!(corners.x2 > corners.x1 && corners.y2 > corners.y1);
                prop_assert!((0.0..=1.0).contains(&output.confidence));
            }
            for record in records(&policy) {
                prop_assert!(record.bounding_box.is_finite() && record.tau.is_finite());
            }
        }
    }
}
