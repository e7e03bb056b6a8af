//! Promises of the adaptive rate.

use super::*;
use crate::policy::FrameState::{I, P};
use crate::policy::Profile;
use crate::policy::tests::{Run, seen};

/// Frames with the detector among `frames` frames of one object that moves by `speed` of its width a frame.
fn calls(run: &mut Run, frames: u32, from: f64, speed: f64) -> usize {
    (0..frames)
        .filter(|&frame| {
            let x = from + 0.1 * speed * f64::from(frame);
            run.see(&[seen(x, 0.9)]) == I
        })
        .count()
}

fn run(asked: &str) -> Run {
    Run::new(asked, Profile::Paper)
}

#[test]
fn the_faster_objects_move_the_more_often_the_detector_runs() {
    let per_speed =
        [0.0, 0.04, 0.11, 0.4].map(|speed| calls(&mut run("adaptive-rate:0.3"), 30, 0.05, speed));
    // The first two frames, then one in 15 (the longest interval), 7, 2 and 1.
    assert_eq!(per_speed, [3, 6, 16, 30]);
}

#[test]
fn no_drift_allowed_is_every_frame_and_much_is_the_longest_interval() {
    assert_eq!(calls(&mut run("adaptive-rate:0"), 20, 0.2, 0.01), 20);
    assert_eq!(calls(&mut run("adaptive-rate:100"), 32, 0.2, 0.1), 4);
}

#[test]
fn an_object_that_appears_brings_the_calls_closer_together() {
    let mut run = run("adaptive-rate:0.1");
    assert_eq!(calls(&mut run, 32, 0.5, 0.0), 4);
    let found = [seen(0.5, 0.9), seen(0.2, 0.9)];
    let until_call = |run: &mut Run| 1 + (0..20).take_while(|_| run.see(&found) == P).count();
    assert_eq!(until_call(&mut run), 15);
    // One of two objects is new after a pause of 15 frames: v = 1/30, halved by the average; 0.1 of a size is 6 frames.
    assert_eq!(until_call(&mut run), 6);
}

#[test]
fn boxes_between_calls_are_predicted_and_a_missed_object_is_gone() {
    let mut run = run("adaptive-rate:0.3");
    calls(&mut run, 10, 0.2, 0.05);
    while run.see(&[seen(0.25, 0.9)]) == I {}
    assert_eq!(run.outcome.boxes.len(), 1);
    while run.see(&[]) == P {}
    assert!(run.outcome.boxes.is_empty());
    assert!(run.records().is_empty());
}

#[test]
fn a_detector_that_fails_is_called_again_and_lost_frames_count() {
    let mut run = run("adaptive-rate:100");
    assert_eq!(run.blind(), P);
    assert!(run.outcome.degraded);
    assert_eq!(run.see(&[seen(0.5, 0.9)]), I);
    assert_eq!(run.see(&[seen(0.5, 0.9)]), I);
    let found = [seen(0.5, 0.9)];
    let known = crate::policy::FrameEvidence::in_view(&found);
    assert_eq!(run.frame(14, known), P);
    assert_eq!(run.frame(1, known), I);
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    for (text, part) in [
        ("adaptive_rate.drift = -1.0", "`drift`"),
        ("adaptive_rate.longest_interval = 0", "`longest_interval`"),
        ("adaptive_rate.newest_weight = 0.0", "`newest_weight`"),
    ] {
        let config: PolicyConfig =
            toml::from_str(&format!("name = 'adaptive-rate'\n{text}")).unwrap();
        let message = config.build().err().unwrap().to_string();
        assert!(message.contains(part), "{message}");
    }
}
