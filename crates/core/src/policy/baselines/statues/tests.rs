use super::*;
use crate::detection::Detection;
use crate::policy::BoxSource::{Detected, Predicted};
use crate::policy::FrameState::{I, P};
use crate::policy::tests::{Run, seen};
use crate::policy::{FrameEvidence, FrameState, Profile};

const SIZE: PictureSize = PictureSize::new(64, 36);

/// A grey picture of value 100 with a block of `width` by `height` pixels of `value`.
fn picture(width: usize, height: usize, value: u8) -> Vec<u8> {
    let mut pixels = vec![100; 64 * 36];
    for row in 0..height {
        pixels[row * 64..][..width].fill(value);
    }
    pixels
}

fn known<'a>(
    size: PictureSize,
    pixels: &'a [u8],
    found: Option<&'a [Detection]>,
) -> FrameEvidence<'a> {
    FrameEvidence {
        grey: Some(GreyPicture { size, pixels }),
        detections: found,
        ..FrameEvidence::default()
    }
}

fn see(run: &mut Run, pixels: &[u8], x: f64) -> FrameState {
    run.frame(1, known(SIZE, pixels, Some(&[seen(x, 0.9)])))
}

/// A run that has seen the empty picture.
fn watching(asked: &str) -> Run {
    let mut run = Run::new(asked, Profile::Paper);
    assert_eq!(see(&mut run, &picture(0, 0, 0), 0.5), I);
    assert_eq!(run.needs, [Need::GreyPicture, Need::Detections]);
    run
}

#[test]
fn an_unchanged_picture_repeats_the_last_boxes() {
    let mut run = watching("statues");
    assert_eq!(run.reported(), [(Detected, 0.5, 0.9)]);
    for _ in 0..3 {
        assert_eq!(see(&mut run, &picture(0, 0, 0), 0.7), P);
        assert_eq!(run.needs, [Need::GreyPicture]);
        assert!(!run.outcome.degraded);
        assert_eq!(run.reported(), [(Predicted, 0.5, 0.9)]);
    }
}

#[test]
fn a_change_of_more_pixels_than_the_component_size_runs_the_detector() {
    for (asked, width, height, value, expected) in [
        ("statues:25", 5, 5, 200, P),
        ("statues:25", 13, 2, 200, I),
        ("statues", 25, 3, 200, P),
        ("statues:75", 19, 4, 200, I),
        ("statues:500", 50, 10, 200, P),
        ("statues:500", 51, 10, 200, I),
        // A pixel has changed from a difference of 30 on, up or down.
        ("statues", 20, 20, 129, P),
        ("statues", 20, 20, 130, I),
        ("statues", 20, 20, 71, P),
        ("statues", 20, 20, 70, I),
    ] {
        let state = see(&mut watching(asked), &picture(width, height, value), 0.7);
        assert_eq!(state, expected, "{asked}: {width}x{height} of {value}");
    }
}

#[test]
fn pictures_are_compared_with_the_previous_frame() {
    let mut run = watching("statues");
    // A slow change is never noticed, however far it goes.
    for value in [120, 140, 160, 180] {
        assert_eq!(see(&mut run, &picture(20, 20, value), 0.7), P);
    }
    // A fast change is noticed in both directions.
    assert_eq!(see(&mut run, &picture(20, 20, 100), 0.7), I);
    assert_eq!(see(&mut run, &picture(20, 20, 180), 0.7), I);
}

#[test]
fn after_lost_frames_the_last_received_picture_is_compared() {
    let mut run = watching("statues");
    let pixels = picture(20, 20, 200);
    let available = known(SIZE, &pixels, Some(&[]));
    assert_eq!(run.begin(1), Need::GreyPicture);
    // That frame is abandoned, and two are lost.
    assert_eq!(run.frame(3, available), I);
    assert_eq!(run.frame(9, available), P);
}

#[test]
fn a_picture_that_cannot_be_compared_runs_the_detector() {
    let mut run = watching("statues");
    assert_eq!(run.see(&[seen(0.7, 0.9)]), I);
    assert_eq!(run.needs, [Need::GreyPicture, Need::Detections]);
    let short = vec![100; 10];
    assert_eq!(see(&mut run, &short, 0.7), I);
    // The last complete picture is still the previous one.
    assert_eq!(see(&mut run, &picture(0, 0, 0), 0.7), P);
    let pixels = picture(0, 0, 0);
    let turned = known(PictureSize::new(36, 64), &pixels, Some(&[]));
    assert_eq!(run.frame(1, turned), I);
    assert_eq!(run.frame(1, turned), P);
}

#[test]
fn a_failed_detector_call_is_repeated_without_a_change() {
    let mut run = watching("statues");
    let changed = picture(20, 20, 200);
    assert_eq!(run.frame(1, known(SIZE, &changed, None)), P);
    assert!(run.outcome.degraded);
    assert_eq!(run.reported(), [(Predicted, 0.5, 0.9)]);
    assert_eq!(see(&mut run, &changed, 0.7), I);
    assert_eq!(see(&mut run, &changed, 0.7), P);
}
