use super::*;
use crate::policy::BoxSource::{Detected, Predicted};
use crate::policy::FrameEvidence;
use crate::policy::FrameState::{I, P};
use crate::policy::tests::{Run, seen};

/// The indices of the frames that ask the detector among the next `frames`.
fn asked(run: &mut Run, frames: u64) -> Vec<u64> {
    let first = run.index;
    let asked = |run: &mut Run| run.see(&[seen(0.5, 0.9)]) == I;
    (first..first + frames).filter(|_| asked(run)).collect()
}

#[test]
fn the_paper_reports_the_last_boxes_and_confidences_on_skipped_frames() {
    let mut run = Run::new("fixed-skip:3", Profile::Paper);
    assert_eq!(run.see(&[seen(0.5, 0.9), seen(0.2, 0.6)]), I);
    assert_eq!(run.reported(), [(Detected, 0.5, 0.9), (Detected, 0.2, 0.6)]);
    for _ in 0..2 {
        assert_eq!(run.see(&[]), P);
        assert!(!run.outcome.degraded);
        let expected = [(Predicted, 0.5, 0.9), (Predicted, 0.2, 0.6)];
        assert_eq!(run.reported(), expected);
    }
    assert_eq!(run.see(&[seen(0.7, 0.8)]), I);
    assert_eq!(run.reported(), [(Detected, 0.7, 0.8)]);
    assert!(run.records().is_empty());
}

#[test]
fn the_published_code_decays_predicted_confidences() {
    let mut run = Run::new("fixed-skip:2", Profile::Reference);
    for x in [0.50, 0.0, 0.52, 0.0, 0.54] {
        run.see(&[seen(x, 0.9)]);
    }
    assert_eq!(run.see(&[]), P);
    let (source, _, confidence) = run.reported()[0];
    assert_eq!(source, Predicted);
    assert!((confidence - 0.9 * (1.0 - run.records()[0].tau / 3e-4)).abs() < 1e-12);
}

#[test]
fn a_setting_overrides_the_profile() {
    for (profile, skipped, objects) in [
        (Profile::Paper, SkippedBoxes::Predict, 1),
        (Profile::Reference, SkippedBoxes::Reuse, 0),
    ] {
        let mut config = PolicyConfig::default();
        config.select(FixedSkip::NAME).unwrap();
        config.profile = profile;
        config.fixed_skip.skipped_boxes = Some(skipped);
        let mut run = Run::with(config.build().unwrap());
        run.see(&[seen(0.5, 0.9)]);
        assert_eq!(run.records().len(), objects);
    }
}

#[test]
fn the_detector_runs_when_the_index_passes_a_multiple() {
    for profile in [Profile::Paper, Profile::Reference] {
        let mut run = Run::new("fixed-skip:3", profile);
        assert_eq!(asked(&mut run, 10), [0, 3, 6, 9]);
        let mut run = Run::new("fixed-skip:1", profile);
        assert_eq!(asked(&mut run, 3), [0, 1, 2]);
        let mut run = Run::new("fixed-skip:2.5", profile);
        assert_eq!(asked(&mut run, 11), [0, 3, 5, 8, 10]);
    }
}

#[test]
fn a_stream_that_starts_after_0_starts_with_the_detector() {
    let mut run = Run::new("fixed-skip:5", Profile::Paper);
    run.index = 13;
    assert_eq!(asked(&mut run, 10), [13, 15, 20]);
    // The camera starts counting again.
    run.index = 1;
    assert_eq!(asked(&mut run, 10), [1, 5, 10]);
}

#[test]
fn a_due_frame_that_is_lost_or_abandoned_makes_the_next_one_due() {
    let found = [seen(0.5, 0.9)];
    let mut run = Run::new("fixed-skip:5", Profile::Paper);
    assert_eq!(asked(&mut run, 4), [0]);
    // 4 and 5 are lost.
    assert_eq!(run.frame(3, FrameEvidence::detections(&found)), I);
    assert!(asked(&mut run, 3).is_empty());
    assert_eq!(run.begin(1), Need::Detections);
    // 10 is abandoned.
    assert_eq!(asked(&mut run, 5), [11, 15]);
}

#[test]
fn a_new_threshold_applies_from_the_next_frame() {
    let mut run = Run::new("fixed-skip:2", Profile::Paper);
    assert_eq!(asked(&mut run, 4), [0, 2]);
    run.policy.set_threshold(4.0).unwrap();
    assert_eq!(asked(&mut run, 9), [4, 8, 12]);
}
