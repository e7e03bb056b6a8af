use super::*;
use crate::detection::ClassId;
use crate::geometry::{BoundingBox, PictureSize};
use crate::policy::tests::Run;
use crate::policy::{BoxSource, FrameEvidence};
use proptest::prelude::*;

fn start(trigger: Trigger) -> Run<ExpectedLoss> {
    let policy = ExpectedLoss::new(ExpectedLossSettings::default(), trigger);
    Run::with(Box::new(policy.unwrap()))
}

fn policy(lambda: f64) -> Run<ExpectedLoss> {
    start(Trigger::ExpectedLoss { lambda })
}

fn detection(x: f64, y: f64, side: f64, confidence: f64) -> Detection {
    Detection {
        bounding_box: BoundingBox::new(x, y, side, side * 1.5),
        class: ClassId(2),
        confidence,
    }
}

/// Frame `frame` of a film: objects of different speeds, one of them seen only sometimes, and stretches of empty road.
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

/// The frames with a detector call among the first `frames` of the film.
fn calls(run: &mut Run<ExpectedLoss>, frames: u64) -> Vec<u64> {
    let mut calls = Vec::new();
    for index in 0..frames {
        if !run.see(&film(index)).is_skipped() {
            calls.push(index);
        }
    }
    calls
}

#[test]
fn the_first_frame_calls_the_detector_even_if_its_first_answers_are_missing() {
    let mut run = policy(100.0);
    let missing = FrameEvidence {
        empty: Some(false),
        ..FrameEvidence::default()
    };
    for _ in 0..2 {
        assert_eq!(run.frame(1, missing), FrameState::P);
        assert!(run.outcome.degraded);
    }
    assert_eq!(run.see(&film(0)), FrameState::EI);
    assert!(!run.outcome.degraded);
    assert_eq!(run.see(&film(1)), FrameState::P);
}

#[test]
fn a_loss_that_grew_in_the_pause_weighs_more() {
    let mut pause = Pause::default();
    pause.skip(0.1);
    pause.skip(0.2);
    assert!((pause.weigh(0.5, 2.0) - (0.5 + 0.4 + 0.3) / 2.0).abs() < 1e-12);
}

#[test]
fn a_higher_lambda_calls_the_detector_less_often() {
    let counts = [0.0, 0.1, 0.5, 2.0, 100.0].map(|lambda| calls(&mut policy(lambda), 400).len());
    assert_eq!(counts[0], 400);
    assert!(counts.is_sorted_by(|a, b| a > b), "{counts:?}");
    // Only the longest pause still calls: one frame in 15.
    assert!((23..=30).contains(&counts[4]), "{counts:?}");
}

#[test]
fn a_fast_object_calls_the_detector_more_often_than_a_slow_one() {
    let skipped = |amplitude: f64| {
        let mut run = policy(0.5);
        let mut skipped = 0;
        for index in 0..200 {
            let x = 0.5 + amplitude * (f64::from(index) * 0.7).sin();
            let state = run.see(&[detection(x, 0.5, 0.1, 0.9)]);
            skipped += usize::from(state.is_skipped());
        }
        skipped
    };
    let steady = skipped(0.0);
    let fast = skipped(0.08);
    assert!(steady > fast + 20, "{steady} {fast}");
}

#[test]
fn a_screen_that_never_says_empty_changes_no_decision() {
    let mut with = policy(0.5);
    let mut without = policy(0.5);
    let mut screened = 0;
    for found in (0..400).map(film) {
        let state = with.see(&found);
        let unscreened = without.frame(1, FrameEvidence::detections(&found));
        screened += u32::from(state == FrameState::EI);
        assert_eq!(state.is_skipped(), unscreened.is_skipped(), "{found:?}");
        assert_eq!(with.outcome.boxes, without.outcome.boxes, "{found:?}");
        assert_ne!(unscreened, FrameState::EI);
    }
    assert!(screened > 0);
}

#[test]
fn a_missed_object_is_rescued_with_falling_confidence_and_removed_at_the_sixth_miss() {
    let mut run = policy(0.0);
    for _ in 0..10 {
        run.see(&[detection(0.5, 0.5, 0.1, 0.9)]);
    }
    let mut last = 1.0;
    for _ in 0..5 {
        assert_eq!(run.see(&[]), FrameState::AI);
        let rescued = run.outcome.boxes[0];
        assert_eq!(rescued.source, BoxSource::Rescued);
        assert!(rescued.confidence < last * 0.76);
        last = rescued.confidence;
    }
    assert_eq!(run.see(&[]), FrameState::I);
    assert!(run.outcome.boxes.is_empty());
}

#[test]
fn a_gap_predicts_as_many_single_frames_do() {
    for frames in [1, 2, 5, 14] {
        let mut single = policy(0.0);
        calls(&mut single, 10);
        single.policy.set_threshold(100.0).unwrap(); // Only the longest pause calls the detector.
        let mut gap = Run::with(single.policy.clone());
        for _ in 0..frames {
            assert_eq!(single.see(&[]), FrameState::P);
        }
        assert_eq!(gap.frame(frames, FrameEvidence::default()), FrameState::P);
        assert_eq!(single.records(), gap.records());
        assert_eq!(single.policy.pause.frames, gap.policy.pause.frames);
    }
}

#[test]
fn too_long_a_gap_or_failure_of_the_detector_and_a_picture_of_another_shape_forget_the_objects() {
    let mut run = policy(0.0);
    run.see(&film(0));
    for _ in 0..30 {
        run.blind();
        assert!(!run.records().is_empty());
    }
    run.blind();
    assert!(run.records().is_empty());
    run.see(&film(0));
    let gap = FrameEvidence::in_view(&[]);
    assert_eq!(run.frame(u32::MAX, gap), FrameState::EI);
    assert!(run.records().is_empty());
    run.see(&film(0));
    // More pixels alone forget nothing.
    for (width, height, kept) in [(2560, 1440, film(0).len()), (640, 480, 0)] {
        run.picture = PictureSize::new(width, height);
        run.begin(1);
        assert_eq!(run.records().len(), kept);
    }
}

#[test]
fn an_even_schedule_meets_its_rate_and_spaces_its_calls_evenly() {
    for skip in [0.0, 0.1, 0.5, 0.62, 0.9, 0.95] {
        let calls = calls(&mut start(Trigger::Even { skip_rate: skip }), 1000);
        let off = calls.len() as f64 - 1000.0 * (1.0 - skip);
        assert!(off.abs() <= 1.0, "{skip}: {}", calls.len());
        let gaps: Vec<_> = calls.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let least = gaps.iter().min().unwrap();
        let most = gaps.iter().max().unwrap();
        assert!(most - least <= 1, "{skip}: {least} to {most}");
    }
}

#[test]
fn a_fixed_schedule_calls_on_one_frame_in_n_and_is_back_in_step_after_a_gap() {
    let mut run = start(Trigger::FixedSkip { n: 4.0 });
    let steps = [1, 1, 1, 1, 1, 1, 9, 1, 1, 2, 1, 3];
    let mut called = Vec::new();
    for step in steps {
        let state = run.frame(step, FrameEvidence::in_view(&[]));
        if !state.is_skipped() {
            called.push(run.index - 1);
        }
    }
    // Of the calls due on the lost frames 8, 12 and 20, one is made up for after each gap.
    assert_eq!(called, [0, 4, 14, 16, 22]);
}

#[test]
fn a_box_without_area_gives_a_new_object_a_finite_velocity() {
    let mut run = policy(0.0);
    for index in 0..5 {
        run.see(&[detection(0.3 + 0.02 * f64::from(index), 0.5, 0.1, 0.9)]);
    }
    let mut thin = detection(0.8, 0.5, 0.1, 0.9);
    thin.bounding_box.height = 5e-324;
    run.see(&[thin]);
    run.blind();
    let records = run.records();
    assert_eq!(records.len(), 2);
    let mut boxes = records.iter().map(|record| record.bounding_box);
    assert!(boxes.all(BoundingBox::is_finite), "{records:?}");
}

/// Valid numbers, and some that a broken detector may return.
fn numbers() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => 0.0..1.0,
        1 => prop::sample::select(vec![
            f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, -1.0, 1.0, 1e-300, 5e-324, 1e-9,
            999.0, 1e3, 1e300, -1e3,
        ]),
    ]
}

prop_compose! {
    fn hostile()(
        x in numbers(), y in numbers(), width in numbers(), height in numbers(), confidence in numbers(),
    ) -> Detection {
        Detection { bounding_box: BoundingBox::new(x, y, width, height), class: ClassId(0), confidence }
    }
}

/// Frames: the number of lost frames before each, and its detections, if any.
fn streams() -> impl Strategy<Value = Vec<(u32, Option<Vec<Detection>>)>> {
    let step = prop_oneof![8 => Just(1u32), 2 => 1..20u32, 1 => Just(u32::MAX)];
    let detections = prop::collection::vec(hostile(), 0..6);
    prop::collection::vec((step, prop::option::weighted(0.9, detections)), 1..60)
}

proptest! {
    #[test]
    fn with_any_detections_numbers_stay_finite_and_boxes_inside(
        stream in streams(),
        lambda in 0.0..2.0f64,
    ) {
        let mut run = policy(lambda);
        for (step, detections) in &stream {
            let known = FrameEvidence { empty: Some(false), grey: None, detections: detections.as_deref() };
            run.frame(*step, known);
            prop_assert!(run.policy.weight.is_finite());
            prop_assert!(run.policy.crowd.is_finite() && run.policy.crowd >= 0.0);
            prop_assert!(run.outcome.tau_max.is_none_or(f64::is_finite));
            for output in &run.outcome.boxes {
                let corners = output.bounding_box.corners();
                prop_assert!(output.bounding_box.is_finite());
                prop_assert!(corners.x1 > -1e-12 && corners.x2 < 1.0 + 1e-12);
                prop_assert!(corners.y1 > -1e-12 && corners.y2 < 1.0 + 1e-12);
                prop_assert!(corners.x2 > corners.x1 && corners.y2 > corners.y1);
                prop_assert!((0.0..=1.0).contains(&output.confidence));
            }
            for record in run.records() {
                prop_assert!(record.bounding_box.is_finite() && record.tau.is_finite());
            }
        }
    }
}

/// What births cost after `pictures` of 8x8 pixels, each with so many values, were followed.
fn loss_of_births(pictures: &[usize]) -> f64 {
    let trigger = Trigger::ExpectedLoss { lambda: 0.5 };
    let mut policy = ExpectedLoss::new(ExpectedLossSettings::default(), trigger).unwrap();
    policy.follower = Some(Box::default());
    for values in pictures {
        policy.follow_boxes(GreyPicture {
            size: PictureSize::new(8, 8),
            pixels: &vec![0; *values],
        });
    }
    policy.births.expected_loss(10)
}

#[test]
fn a_picture_that_cannot_be_followed_changes_nothing() {
    assert_eq!(loss_of_births(&[63, 63, 63]), loss_of_births(&[]));
    assert_eq!(loss_of_births(&[63, 64, 63, 64]), loss_of_births(&[64]));
    assert_ne!(loss_of_births(&[64]), loss_of_births(&[]));
}
