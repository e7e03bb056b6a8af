use super::*;
use crate::policy::FrameState::{I, P};
use crate::policy::tests::{Run, seen};
use crate::policy::{BoxSource, FrameEvidence, Profile};
use proptest::prelude::*;

fn frames_until_detector(run: &mut Run) -> usize {
    let mut frames = 1..100;
    frames.find(|_| run.see(&[seen(0.5, 0.9)]) == I).unwrap()
}

/// A confirmed object that does not move.
fn standing(profile: Profile) -> Run {
    let mut run = Run::new("ctd:0.5", profile);
    for _ in 0..30 {
        frames_until_detector(&mut run);
    }
    assert!(run.records()[0].confirmed);
    run
}

#[test]
fn the_distance_is_the_tabulated_quantile_of_chi_squared() {
    // Upper tail of chi-squared with four degrees of freedom, from tables.
    for (confidence, quantile) in [
        (0.99, 0.297_109_480_506_53),
        (0.90, 1.063_623_216_779_22),
        (0.50, 3.356_693_980_033_32),
        (0.05, 9.487_729_036_781_15),
        (0.01, 13.276_704_135_987_6),
    ] {
        let found = distance_with_confidence(confidence);
        assert!((found - quantile).abs() < 1e-10, "{confidence}: {found}");
    }
}

proptest! {
    #[test]
    fn every_allowed_threshold_has_its_distance(exponent in -9.0..0.0f64, high in any::<bool>()) {
        let small = 10f64.powf(exponent).min(0.5);
        let confidence = if high { 1.0 - small } else { small };
        let y = distance_with_confidence(confidence) / 2.0;
        prop_assert!(y.is_finite() && y > 0.0);
        let back = (-y).exp() * (1.0 + y);
        prop_assert!((back / confidence - 1.0).abs() < 1e-12, "{confidence}: {back}");
    }
}

#[test]
fn a_stationary_object_is_predicted_for_eight_frames_counting_lost_ones() {
    let found = [seen(0.5, 0.9)];
    for profile in [Profile::Paper, Profile::Reference] {
        let mut run = standing(profile);
        assert_eq!(frames_until_detector(&mut run), 9);
        for (step, state) in [(8, P), (1, I), (9, I)] {
            assert_eq!(run.frame(step, FrameEvidence::detections(&found)), state);
        }
        assert_eq!(run.see(&[]), P);
        assert_eq!(run.reported()[0].0, BoxSource::Predicted);
    }
}

#[test]
fn a_straying_prediction_calls_the_detector_sooner_at_a_higher_threshold() {
    let [lower, higher] = ["ctd:0.5", "ctd:0.9"].map(|asked| {
        let mut run = Run::new(asked, Profile::Paper);
        let places = (0..60).map(|frame| 0.2 + 0.01 * f64::from(frame));
        let calls = places.filter(|x| run.see(&[seen(*x, 0.9)]) == I).count();
        assert_eq!(run.records().len(), 1);
        calls
    });
    assert!(lower < higher, "{lower} {higher}");
}

#[test]
fn without_objects_every_frame_asks_the_detector() {
    let mut run = Run::new("ctd", Profile::Paper);
    for _ in 0..5 {
        assert_eq!(run.see(&[]), I);
    }
}
