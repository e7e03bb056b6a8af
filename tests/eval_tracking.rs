//! HOTA and IDF1 equal those of TrackEval on the same boxes.

use crate::golden_traces::replay::{Screen, decide_frame, policy};
use crate::golden_traces::shared_data::{detections, sequences};
use crate::support::{ask_script, project};
use albireo_core::policy::{Outcome, Profile};
use albireo_eval::boxes::ScoredBox;
use albireo_eval::data::Clip;
use albireo_eval::judge::SHOWN_CONFIDENCE;
use albireo_eval::judge::tracking;
use serde_json::{Value, json};
use std::process::Command;

/// The boxes that `policy` shows for a recording.
fn shown(clip: &Clip, asked: &str) -> Vec<Vec<ScoredBox>> {
    let mut policy = policy(asked, Profile::Paper);
    let mut outcome = Outcome::default();
    let mut boxes = Vec::new();
    for (index, found) in (0..).zip(detections(clip)) {
        let (screen, picture) = (Screen::NeverEmpty, clip.picture);
        decide_frame(&mut *policy, index, screen, picture, &found, &mut outcome);
        let scored = outcome.boxes.iter().map(|shown| ScoredBox {
            corners: shown.bounding_box.pixel_corners(picture),
            class: shown.class,
            confidence: shown.confidence,
            object: shown.object.map(|object| object.0),
        });
        boxes.push(scored.collect());
    }
    boxes
}

/// A clip in the format of the script.
fn request(tracks: &[Vec<ScoredBox>], truth: &[Vec<ScoredBox>]) -> Value {
    let row = |found: &ScoredBox| {
        let c = found.corners;
        json!([found.object, c.x1, c.y1, c.x2, c.y2])
    };
    let is_counted = |found: &&ScoredBox| found.confidence >= SHOWN_CONFIDENCE;
    let rows = |boxes: &Vec<ScoredBox>| boxes.iter().filter(is_counted).map(row).collect();
    let [tracks, truth] =
        [tracks, truth].map(|frames| frames.iter().map(rows).collect::<Vec<Value>>());
    json!({"tracks": tracks, "truth": truth})
}

#[test]
#[ignore = "needs ../shared and the wheel"]
fn shared_wheel_tracks_of_every_recorded_sequence_score_as_in_trackeval() {
    let clips = sequences();
    let mut requests = Vec::new();
    let mut ours = Vec::new();
    for policy in ["albireo", "expected-loss:0.3", "fixed-skip-in-tracker:3"] {
        for clip in &clips {
            if let Some(truth) = &clip.truth {
                let tracks = shown(clip, policy);
                requests.push(request(&tracks, truth));
                let judged = tracking(&tracks, truth).expect("boxes and truth name their objects");
                ours.push((format!("{policy} on {}", clip.name), judged));
            }
        }
    }
    assert_eq!(ours.len(), 3 * 17);
    let mut script = Command::new(crate::wheel::python());
    script.arg(project("tests/python/tracking_scores.py"));
    let theirs = ask_script(&mut script, &json!(requests));
    let theirs: Vec<(f64, f64)> = serde_json::from_value(theirs).expect("two figures a clip");
    assert_eq!(theirs.len(), ours.len());
    for ((what, ours), (hota, idf1)) in ours.iter().zip(theirs) {
        println!("{what}: {ours:?}");
        for (ours, theirs) in [(ours.hota, hota), (ours.idf1, idf1)] {
            assert!((ours - theirs).abs() < 1e-9, "{what}: {ours}, not {theirs}");
        }
        assert!(hota > 0.1 && idf1 > 0.1, "{what}: {ours:?}");
    }
}
