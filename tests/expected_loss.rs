//! The accuracy of the expected-loss policy on the recordings.

use crate::support::shared;

#[path = "../crates/eval/examples/equal_skip.rs"]
#[allow(dead_code)]
mod equal_skip;
use equal_skip::{Point, Recordings};

#[path = "../crates/eval/examples/join.rs"]
#[allow(dead_code)]
mod join;
use join::Groups;

fn recordings(half_rate: bool, confidence: f64) -> Recordings {
    let folder = shared("data/recorded");
    let read = Recordings::read(&folder, half_rate, confidence).expect("the recordings");
    assert_eq!(read.clips.len(), 17, "sequences with ground truth");
    read
}

fn ap50(point: &Point) -> f64 {
    point.mean(|found| found.ap50)
}

/// The AP@50 of expected-loss at `skip_rate`: the mean over thresholds around it, because the curve is noisy.
fn accuracy(recordings: &Recordings, skip_rate: f64) -> f64 {
    let at = |offset: f64| recordings.at_skip_rate("expected-loss", skip_rate + offset);
    let points = [-0.02, -0.01, 0.0, 0.01, 0.02].map(|offset| at(offset).expect("it runs"));
    let count = points.len() as f64;
    let reached = points.iter().map(Point::skip_rate).sum::<f64>() / count;
    let difference = (reached - skip_rate).abs();
    assert!(difference < 0.004, "{reached} for {skip_rate}");
    points.iter().map(ap50).sum::<f64>() / count
}

#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_reaches_its_figures_as_recorded_and_at_half_the_frame_rate() {
    let as_recorded = [(0.24, 0.757), (0.38, 0.750), (0.49, 0.743), (0.60, 0.725)];
    let at_half = [(0.38, 0.715), (0.49, 0.690)];
    for (half_rate, figures) in [(false, &as_recorded[..]), (true, &at_half)] {
        let clips = recordings(half_rate, 0.5);
        for &(skip_rate, wanted) in figures {
            let reached = accuracy(&clips, skip_rate);
            println!("skip {skip_rate}: AP@50 {reached:.4}, wanted {wanted}");
            assert!(reached >= wanted, "{reached} at {skip_rate}");
        }
    }
}

/// With low-confidence detections, vanilla gets the same ones.
#[test]
#[ignore = "needs ../shared"]
fn shared_expected_loss_is_as_accurate_as_vanilla_at_less_than_half_the_calls() {
    for (confidence, expected, skip_rate) in [(0.5, 0.711, 0.65), (0.1, 0.765, 0.55)] {
        let clips = recordings(false, confidence);
        let vanilla = ap50(&clips.run(&clips.clips, "vanilla").expect("it runs"));
        assert!((vanilla - expected).abs() < 1e-3, "{confidence}: {vanilla}");
        let reached = accuracy(&clips, skip_rate);
        assert!(reached >= vanilla, "{confidence}: {reached}, not {vanilla}");
    }
}

#[test]
#[ignore = "needs ../shared"]
fn shared_cameras_that_join_runs_need_fewer_for_as_many_pictures_and_are_as_accurate() {
    let groups = Groups::read(&shared("data/recorded")).expect("the recordings");
    let alone = groups.run("expected-loss:0.3", 0.0).expect("it runs");
    let joining = groups.with_pictures("expected-loss", 0.5, alone.pictures).expect("it runs");
    assert!(joining.pictures <= alone.pictures);
    let share = joining.runs as f64 / alone.runs as f64;
    assert!(share < 0.92, "{} runs, {} alone", joining.runs, alone.runs);
    let change = joining.change(&alone).expect("clips");
    assert_eq!(change.clips, 16);
    let [lower, _] = change.interval.expect("clips differ");
    assert!(lower > -1.0, "AP@50 {change:?}");
}
