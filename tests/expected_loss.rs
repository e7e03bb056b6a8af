//! The accuracy of the expected-loss policy on the recordings.

use crate::support::shared;

#[path = "../crates/eval/examples/equal_skip.rs"]
#[allow(dead_code)]
mod equal_skip;
use equal_skip::{Point, Recordings};

fn recordings(half_rate: bool, confidence: f64) -> Recordings {
    let folder = shared("data/recorded");
    let read = Recordings::read(&folder, half_rate, confidence).expect("the recordings");
    assert_eq!(read.clips.len(), 17, "sequences with ground truth");
    read
}

fn ap50(point: &Point) -> f64 {
    point.mean(|found| found.ap50)
}

/// The AP@50 of expected-loss at `skip_rate`, as the mean over thresholds around the rate: a single one is a sample of a noisy
/// curve.
fn accuracy(recordings: &Recordings, skip_rate: f64) -> f64 {
    let points: Vec<_> = [-0.02, -0.01, 0.0, 0.01, 0.02]
        .iter()
        .map(|offset| {
            recordings
                .at_skip_rate("expected-loss", skip_rate + offset)
                .expect("it runs")
        })
        .collect();
    let count = points.len() as f64;
    let reached = points.iter().map(Point::skip_rate).sum::<f64>() / count;
    assert!(
        (reached - skip_rate).abs() < 0.004,
        "{reached} for {skip_rate}"
    );
    points.iter().map(ap50).sum::<f64>() / count
}

fn reaches(recordings: &Recordings, figures: &[(f64, f64)]) {
    for &(skip_rate, wanted) in figures {
        let reached = accuracy(recordings, skip_rate);
        println!("skip {skip_rate}: AP@50 {reached:.4}, wanted {wanted}");
        assert!(reached >= wanted, "{reached} at {skip_rate}");
    }
}

#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_reaches_its_figures_as_recorded() {
    let figures = [(0.24, 0.757), (0.38, 0.750), (0.49, 0.743), (0.60, 0.725)];
    reaches(&recordings(false, 0.5), &figures);
}

#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_reaches_its_figures_at_half_the_frame_rate() {
    reaches(&recordings(true, 0.5), &[(0.38, 0.715), (0.49, 0.690)]);
}

#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_is_as_accurate_as_vanilla_while_skipping_two_frames_of_three() {
    let clips = recordings(false, 0.5);
    let vanilla = ap50(&clips.run(&clips.clips, "vanilla").expect("it runs"));
    assert!((vanilla - 0.711).abs() < 1e-3, "{}", vanilla);
    assert!(accuracy(&clips, 0.65) >= vanilla);
}

/// With low-confidence detections, expected-loss beats vanilla with the same ones at a detector call on less than half the
/// frames.
#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_with_unsure_detections_beats_vanilla_with_the_same() {
    let clips = recordings(false, 0.1);
    let vanilla = ap50(&clips.run(&clips.clips, "vanilla").expect("it runs"));
    assert!((vanilla - 0.765).abs() < 1e-3, "{}", vanilla);
    assert!(accuracy(&clips, 0.55) >= vanilla);
}
