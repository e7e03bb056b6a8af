//! What the expected-loss policy reaches on the recordings.
#![allow(clippy::expect_used)]

use crate::support::shared;
use albireo_eval::data::recorded;
use albireo_eval::frontier::{Candidate, View, ViewedClip};

fn looked_at(view: &View) -> Vec<ViewedClip> {
    let clips = recorded::read(&shared("data/recorded")).expect("the recordings");
    let viewed: Vec<_> = clips
        .clips
        .iter()
        .filter_map(|clip| view.look(clip))
        .collect();
    assert_eq!(viewed.len(), 17, "sequences with ground truth");
    viewed
}

/// AP@50 of expected-loss at `skip_rate`. One setting of the knob is a sample of a noisy curve, so it is
/// the mean of the settings at and around the rate that counts.
fn accuracy(clips: &[ViewedClip], skip_rate: f64) -> f64 {
    let candidate = Candidate::as_reported("expected-loss").expect("it is a policy");
    let points: Vec<_> = [-0.02, -0.01, 0.0, 0.01, 0.02]
        .iter()
        .map(|offset| {
            candidate
                .at_skip_rate(skip_rate + offset, clips)
                .expect("it runs")
        })
        .collect();
    let count = points.len() as f64;
    let reached = points.iter().map(|point| point.skip_rate).sum::<f64>() / count;
    assert!(
        (reached - skip_rate).abs() < 0.004,
        "{reached} for {skip_rate}"
    );
    points.iter().map(|point| point.ap50).sum::<f64>() / count
}

fn reaches(view: &View, figures: &[(f64, f64)]) {
    let clips = looked_at(view);
    for &(skip_rate, wanted) in figures {
        let reached = accuracy(&clips, skip_rate);
        println!(
            "{}: skip {skip_rate}: AP@50 {reached:.4}, wanted {wanted}",
            view.name
        );
        assert!(reached >= wanted, "{}: {reached} at {skip_rate}", view.name);
    }
}

#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_reaches_its_figures_as_recorded() {
    let figures = [(0.24, 0.757), (0.38, 0.750), (0.49, 0.743), (0.60, 0.725)];
    reaches(&View::as_recorded(0.5), &figures);
}

#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_reaches_its_figures_at_half_the_frame_rate() {
    reaches(&View::half_rate(0.5), &[(0.38, 0.715), (0.49, 0.690)]);
}

#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_is_as_accurate_as_vanilla_while_skipping_two_frames_of_three() {
    let clips = looked_at(&View::as_recorded(0.5));
    let vanilla = Candidate::as_reported("vanilla").expect("it is a policy");
    let vanilla = vanilla.run(&clips).expect("it runs");
    assert!((vanilla.ap50 - 0.702).abs() < 1e-3, "{}", vanilla.ap50);
    assert!(accuracy(&clips, 0.65) >= vanilla.ap50);
}

/// With detections that the detector is unsure of, expected-loss beats Vanilla with the same ones while it
/// calls the detector on less than half the frames.
#[test]
#[ignore = "needs ../shared"]
fn shared_unsure_detections_pay_more_than_vanilla_with_the_same() {
    let clips = looked_at(&View::as_recorded(0.1));
    let vanilla = Candidate::as_reported("vanilla").expect("it is a policy");
    let vanilla = vanilla.run(&clips).expect("it runs");
    assert!((vanilla.ap50 - 0.753).abs() < 1e-3, "{}", vanilla.ap50);
    assert!(accuracy(&clips, 0.55) >= vanilla.ap50);
}
