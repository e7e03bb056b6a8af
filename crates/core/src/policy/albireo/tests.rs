use super::*;
use crate::geometry::{BoundingBox, PictureSize};
use crate::policy::tests::{Run, random, seen};
use crate::policy::{BoxSource, FrameEvidence, FrameState, OutputBox};

fn start(settings: AlbireoSettings, u: f64) -> Run<Albireo> {
    Run::with(Box::new(Albireo::new(settings, u).unwrap()))
}

/// A run of the paper's profile that never skips, with one confirmed object.
fn watching(settings: AlbireoSettings) -> Run<Albireo> {
    let mut run = start(settings, 1e-9);
    for (state, cause, confirmed) in [
        (FrameState::EI, CallCause::Screen, false),
        (FrameState::I, CallCause::NewObject, false),
        (FrameState::I, CallCause::NewObject, true),
    ] {
        assert_eq!(run.see(&[seen(0.5, 0.9)]), state);
        assert_eq!(run.outcome.cause, Some(cause));
        assert_eq!(run.outcome.boxes[0].confirmed, confirmed);
    }
    run
}

#[test]
fn in_the_paper_detector_frames_report_the_detectors_boxes_and_rescues() {
    let mut run = watching(AlbireoSettings::paper());
    let found = [seen(0.8, 0.6), seen(0.503, 0.7)];
    assert_eq!(run.see(&found), FrameState::I);
    assert_eq!(run.outcome.cause, Some(CallCause::Uncertain));
    let boxes = &run.outcome.boxes;
    assert_eq!(boxes.len(), 2);
    for (reported, found) in boxes.iter().zip(&found) {
        assert_eq!(reported.bounding_box, found.bounding_box);
        assert_eq!(reported.confidence, found.confidence);
        assert_eq!(reported.source, BoxSource::Detected);
    }
    let assert_objects = |boxes: &[OutputBox]| {
        assert_eq!(boxes[0].object.unwrap().0, 1);
        assert!(!boxes[0].confirmed);
        assert_eq!(boxes[1].object.unwrap().0, 0);
        assert!(boxes[1].confirmed);
    };
    assert_objects(boxes);

    assert_eq!(run.see(&[seen(0.8, 0.6)]), FrameState::AI);
    let boxes = &run.outcome.boxes;
    assert_objects(boxes);
    assert_eq!(boxes[1].source, BoxSource::Rescued);
    assert_eq!(boxes[1].confidence, 0.7);
    assert_ne!(boxes[1].bounding_box, found[1].bounding_box);
}

#[test]
fn in_the_reference_detector_frames_report_filtered_boxes_with_decayed_confidence() {
    let mut run = start(AlbireoSettings::reference(), 3e-4);
    run.see(&[seen(0.5, 0.9)]);
    // A new object: 1 - 2.5e-4 / 3e-4 of its confidence.
    assert!((run.outcome.boxes[0].confidence - 0.9 / 6.0).abs() < 1e-12);
    assert_eq!(run.outcome.boxes[0].source, BoxSource::Detected);
    run.see(&[seen(0.52, 0.9)]);
    let detected = seen(0.52, 0.9).bounding_box;
    assert_ne!(run.outcome.boxes[0].bounding_box, detected);
    run.policy.set_threshold(1e-9).unwrap();
    run.see(&[seen(0.53, 0.9)]);
    assert_eq!(run.see(&[]), FrameState::AI);
    assert!((run.outcome.boxes[0].confidence - 0.09).abs() < 1e-12);
    assert_eq!(run.outcome.boxes[0].source, BoxSource::Rescued);
}

#[test]
fn predicted_frames_report_all_active_objects() {
    let mut run = watching(AlbireoSettings::paper());
    run.see(&[seen(0.5, 0.9), seen(0.8, 0.6)]);
    run.policy.set_threshold(1.0).unwrap();
    assert_eq!(run.blind(), FrameState::P);
    assert!(!run.outcome.degraded);
    let found = run.outcome.boxes.iter().map(|b| (b.source, b.confidence));
    let expected = [0.9, 0.6].map(|confidence| (BoxSource::Predicted, confidence));
    assert_eq!(found.collect::<Vec<_>>(), expected);
}

#[test]
fn tau_equal_to_u_runs_the_detector_in_the_paper_and_skips_in_the_reference() {
    for (settings, need) in [
        (AlbireoSettings::paper(), Need::Detections),
        (AlbireoSettings::reference(), Need::Nothing),
    ] {
        let mut probe = start(settings, 1e-9);
        probe.see(&[seen(0.5, 0.9)]);
        probe.begin(1);
        let tau = probe.policy.progress.tau_max.unwrap();
        let mut run = start(settings, tau);
        run.see(&[seen(0.5, 0.9)]);
        assert_eq!(run.begin(1), need);
    }
}

#[test]
fn a_cap_calls_the_detector_when_it_is_due() {
    use CallCause::{ObjectCap, PeriodicCap as Periodic};
    let never = u32::MAX;
    for (cap, counts, due, cause) in [
        (7, PeriodicCap::SinceDetector, vec![2 + 7, 2 + 14], Periodic),
        (7, PeriodicCap::FrameIndex, vec![7, 14], Periodic),
        // The age limit of an object, t_max.
        (never, PeriodicCap::SinceDetector, vec![2 + 15], ObjectCap),
    ] {
        let mut settings = AlbireoSettings::paper();
        settings.periodic_cap = cap;
        settings.periodic_cap_counts = counts;
        let mut run = watching(settings);
        run.policy.set_threshold(1.0).unwrap();
        let mut called = Vec::new();
        while run.index < 18 {
            let index = run.index;
            if run.see(&[seen(0.5, 0.9)]) == FrameState::I {
                assert_eq!(run.outcome.cause, Some(cause), "{counts:?}");
                called.push(index);
            }
        }
        assert_eq!(called, due, "{counts:?}");
    }
}

#[test]
fn a_due_frame_that_is_lost_or_abandoned_makes_the_next_one_due() {
    let mut settings = AlbireoSettings::paper();
    settings.periodic_cap = 7;
    settings.periodic_cap_counts = PeriodicCap::FrameIndex;
    let mut run = watching(settings);
    run.policy.set_threshold(1.0).unwrap();
    run.index = 6;
    assert_eq!(run.blind(), FrameState::P);
    // 7 and 8 are lost.
    let found = [seen(0.5, 0.9)];
    assert_eq!(run.frame(3, FrameEvidence::in_view(&found)), FrameState::I);
    run.index = 13;
    assert_eq!(run.blind(), FrameState::P);
    assert_eq!(run.begin(1), Need::Detections);
    // 14 is abandoned.
    assert_eq!(run.see(&[seen(0.5, 0.9)]), FrameState::I);
    assert_eq!(run.blind(), FrameState::P);
}

#[test]
fn gaps_predictions_and_abandoned_frames_leave_the_same_objects() {
    let mut gap = watching(AlbireoSettings::paper());
    gap.policy.set_threshold(1.0).unwrap();
    let again = || {
        let mut run = Run::with(gap.policy.clone());
        run.index = gap.index;
        run
    };
    let mut predicted = again();
    let mut abandoned = again();
    gap.frame(4, FrameEvidence::default());
    for _ in 0..4 {
        predicted.blind();
    }
    for _ in 0..3 {
        abandoned.begin(1);
    }
    abandoned.blind();
    assert_eq!(gap.outcome, predicted.outcome);
    assert_eq!(gap.outcome, abandoned.outcome);
    assert_eq!(gap.records(), predicted.records());
    assert_eq!(gap.records(), abandoned.records());
    let record = gap.records()[0];
    assert_eq!((record.since_infer, record.since_update), (4, 4));
}

#[test]
fn a_new_threshold_applies_from_the_next_frame() {
    let mut run = watching(AlbireoSettings::paper());
    assert_eq!(run.begin(1), Need::Detections);
    run.policy.set_threshold(1.0).unwrap();
    run.policy.answer(Evidence::Detections(&[seen(0.5, 0.9)]));
    run.policy.finish(&mut run.outcome);
    assert_eq!(run.outcome.state, FrameState::I);
    assert_eq!(run.begin(1), Need::Nothing);
}

#[test]
fn evidence_of_the_wrong_kind_is_ignored() {
    let mut run = watching(AlbireoSettings::paper());
    assert_eq!(run.begin(1), Need::Detections);
    let need = run.policy.answer(Evidence::Screen { empty: true });
    assert_eq!(need, Need::Nothing);
    run.policy.finish(&mut run.outcome);
    assert_eq!(run.outcome.state, FrameState::P);
    assert!(run.outcome.degraded);
    assert_eq!(run.outcome.boxes.len(), 1);
}

type Decided = (FrameState, Vec<u64>);

/// Decides a minute of a street in pictures of `size`: cars come, go, jitter and are sometimes missed, at fractions of it.
fn decided(size: PictureSize, settings: AlbireoSettings, u: f64) -> Vec<Decided> {
    let mut run = start(settings, u);
    run.picture = size;
    let mut next = random(7);
    let mut frames = Vec::new();
    for index in 0..600_u64 {
        let mut found = Vec::new();
        for car in 0..6_u64 {
            let age = (index + 47 * car) % 120;
            let missed = next() < 0.1;
            let mut jitter = || 0.004 * (next() - 0.5);
            let place = BoundingBox::new(
                0.1 + 0.007 * age as f64 + jitter(),
                0.3 + 0.08 * car as f64 + jitter(),
                0.06 + jitter(),
                0.08 + jitter(),
            );
            if age < 100 && !missed {
                found.push(Detection {
                    bounding_box: place.pixel_corners(size).normalise(size),
                    ..seen(0.5, 0.9)
                });
            }
        }
        let state = run.see(&found);
        let ids = run.records().iter().map(|object| object.id.0).collect();
        frames.push((state, ids));
    }
    frames
}

#[test]
fn decisions_do_not_depend_on_the_picture_size() {
    let sizes = [
        PictureSize::new(1280, 720),
        PictureSize::new(640, 480),
        PictureSize::new(720, 576),
        PictureSize::new(1920, 1080),
        PictureSize::new(3840, 2160),
    ];
    for u in [3e-4, 5e-4, 7e-4, 1e-3] {
        let [expected, others @ ..] = sizes.map(|size| decided(size, AlbireoSettings::paper(), u));
        let skipped = expected.iter().filter(|(state, _)| state.is_skipped()).count();
        assert!((60..480).contains(&skipped), "{skipped} of 600 at u = {u}");
        assert!(others.iter().all(|other| *other == expected), "u = {u}");
    }
    // The published code counts pixels, and skips nothing in small pictures.
    let u = Albireo::THRESHOLD.default;
    let published = |size| decided(size, AlbireoSettings::reference(), u);
    assert_ne!(published(sizes[0]), published(sizes[1]));
}
