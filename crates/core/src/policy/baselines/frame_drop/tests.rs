//! Promises of frame dropping with an event trigger.

use super::*;
use crate::policy::BoxSource::{Predicted, Rescued};
use crate::policy::FrameEvidence;
use crate::policy::FrameState::{I, P};
use crate::policy::tests::{Run, seen};

const SIZE: PictureSize = PictureSize::new(64, 36);

/// A grey picture with a block of `side` pixels whose left upper corner is at `x`, `y`.
fn picture(x: usize, y: usize, side: usize) -> Vec<u8> {
    let mut pixels = vec![100; 64 * 36];
    for row in y..y + side {
        pixels[row * 64 + x..][..side].fill(200);
    }
    pixels
}

fn see(run: &mut Run, pixels: &[u8], x: f64) -> FrameState {
    let found = [seen(x, 0.9)];
    run.frame(
        1,
        FrameEvidence {
            grey: Some(GreyPicture { size: SIZE, pixels }),
            detections: Some(&found),
            ..FrameEvidence::default()
        },
    )
}

fn run() -> Run {
    let mut config = PolicyConfig::default();
    config.select("frame-drop:8").unwrap();
    config.frame_drop.component_size = 10.0;
    let mut run = Run::of(&config);
    let empty = picture(0, 0, 0);
    // In the middle of the picture, 0.1 wide and high: columns 28 to 36 and rows 15 to 21 with the margin.
    assert_eq!(see(&mut run, &empty, 0.5), I);
    assert_eq!(run.needs, [Need::GreyPicture, Need::Detections]);
    run
}

#[test]
fn without_events_the_detector_runs_on_every_nth_frame() {
    let mut run = run();
    let empty = picture(0, 0, 0);
    let asked: Vec<_> = (1..20)
        .filter(|_| see(&mut run, &empty, 0.5) == I)
        .collect();
    assert_eq!(asked, [8, 16]);
    assert_eq!(run.outcome.boxes[0].source, Predicted);
}

#[test]
fn a_change_that_no_object_explains_calls_the_detector_out_of_turn() {
    let mut changed = run();
    assert_eq!(see(&mut changed, &picture(5, 5, 4), 0.5), I);
    assert_eq!(changed.outcome.cause, Some(CallCause::Changed));
    // Too small, and where the object is.
    assert_eq!(see(&mut run(), &picture(5, 5, 3), 0.5), P);
    assert_eq!(see(&mut run(), &picture(30, 16, 4), 0.5), P);
}

#[test]
fn without_a_picture_the_schedule_alone_decides() {
    let mut run = run();
    let found = [seen(0.5, 0.9)];
    for _ in 1..8 {
        assert_eq!(run.frame(1, FrameEvidence::detections(&found)), P);
        assert!(!run.outcome.degraded);
    }
    assert_eq!(run.frame(1, FrameEvidence::detections(&found)), I);
}

#[test]
fn a_detector_that_fails_at_an_event_is_called_again() {
    let mut run = run();
    let pixels = picture(5, 5, 4);
    let grey = Some(GreyPicture {
        size: SIZE,
        pixels: &pixels,
    });
    let without = FrameEvidence {
        grey,
        ..FrameEvidence::default()
    };
    assert_eq!(run.frame(1, without), P);
    assert!(run.outcome.degraded);
    assert_eq!(see(&mut run, &pixels, 0.5), I);
    assert_eq!(run.outcome.cause, Some(CallCause::Retry));
}

#[test]
fn with_a_cue_an_unexplained_box_calls_the_detector_and_no_picture_is_asked_for() {
    let mut config = PolicyConfig::default();
    config.select("frame-drop:10").unwrap();
    let object = seen(0.5, 0.9).bounding_box;
    let newcomer = seen(0.2, 0.9).bounding_box;
    let cue: Vec<Vec<BoundingBox>> = (0..9)
        .map(|frame| match frame {
            0..5 => vec![object],
            _ => vec![object, newcomer],
        })
        .collect();
    let mut run = Run::of(&config);
    run.policy = Box::new(FrameDrop::with_cue(&config, cue.into()).unwrap());
    let both = [seen(0.5, 0.9), seen(0.2, 0.8)];
    let mut asked = Vec::new();
    for frame in 0..16 {
        let found = if frame < 5 { &both[..1] } else { &both[..] };
        if run.see(found) == I {
            asked.push((frame, run.outcome.cause.unwrap()));
            assert_eq!(run.needs, [Need::Detections]);
        } else {
            assert!(run.needs.is_empty());
        }
    }
    let expected = [
        (0, CallCause::Start),
        (5, CallCause::NewObject),
        (15, CallCause::Schedule),
    ];
    assert_eq!(asked, expected);
}

#[test]
fn a_confirmed_object_lives_through_two_misses() {
    let mut config = PolicyConfig::default();
    config.select("frame-drop:1").unwrap();
    let mut run = Run::of(&config);
    for _ in 0..4 {
        run.see(&[seen(0.5, 0.9)]);
    }
    for _ in 0..2 {
        assert_eq!(run.see(&[]), I);
        assert_eq!(run.outcome.boxes[0].source, Rescued);
    }
    run.see(&[]);
    assert!(run.outcome.boxes.is_empty());
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    for (text, part) in [
        ("frame_drop.n = 0.5", "`n`"),
        ("frame_drop.component_size = -1.0", "`component_size`"),
        ("frame_drop.pixel_difference = 0", "`pixel_difference`"),
    ] {
        let config: PolicyConfig = toml::from_str(&format!("name = 'frame-drop'\n{text}")).unwrap();
        let message = config.build().err().unwrap().to_string();
        assert!(message.contains(part), "{message}");
    }
    assert_eq!(FrameDropSettings::default().n, FrameDrop::KNOB.default);
}
