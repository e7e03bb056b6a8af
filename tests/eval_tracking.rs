//! HOTA and IDF1 are what TrackEval computes on the same boxes.
#![allow(clippy::expect_used)]

use crate::golden_traces::replay::{Screen, decide_frame};
use crate::support::{answer_of, shared};
use albireo_core::policy::{Outcome, PolicyConfig};
use albireo_eval::average_precision::{SHOWN_CONFIDENCE, ScoredBox};
use albireo_eval::data::{Clip, recorded};
use albireo_eval::tracking::tracking;
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;

/// What `policy` shows of a recording.
fn shown(clip: &Clip, policy: &str) -> Vec<Vec<ScoredBox>> {
    let mut config = PolicyConfig::default();
    config.select(policy).expect("a policy");
    let mut policy = config.build().expect("a policy");
    let mut outcome = Outcome::default();
    let mut boxes = Vec::new();
    for (index, found) in clip.detections.iter().flatten().enumerate() {
        let found = found.iter().filter(|found| found.confidence >= 0.5);
        let found: Vec<_> = found.map(|found| found.normalise(clip.picture)).collect();
        let (screen, picture) = (Screen::NeverEmpty, clip.picture);
        decide_frame(
            &mut *policy,
            index as u64,
            screen,
            picture,
            &found,
            &mut outcome,
        );
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

/// A clip in the form the script takes.
fn request(tracks: &[Vec<ScoredBox>], truth: &[Vec<ScoredBox>]) -> Value {
    let tracks = tracks.iter().map(|frame| {
        let counted = frame
            .iter()
            .filter(|found| found.confidence >= SHOWN_CONFIDENCE);
        let rows = counted.map(|found| {
            json!([
                found.object,
                found.corners.x1,
                found.corners.y1,
                found.corners.x2,
                found.corners.y2
            ])
        });
        rows.collect::<Vec<_>>()
    });
    let truth = truth.iter().map(|frame| {
        let rows = frame.iter().map(|known| {
            json!([
                known.object,
                known.corners.x1,
                known.corners.y1,
                known.corners.x2,
                known.corners.y2
            ])
        });
        rows.collect::<Vec<_>>()
    });
    json!({"tracks": tracks.collect::<Vec<_>>(), "truth": truth.collect::<Vec<_>>()})
}

#[test]
#[ignore = "needs ../shared and the wheel"]
fn shared_wheel_tracks_of_every_recorded_sequence_score_as_in_trackeval() {
    let clips = recorded::read(&shared("data/recorded")).expect("the recordings");
    let mut requests = Vec::new();
    let mut ours = Vec::new();
    for policy in ["albireo", "expected-loss:0.3", "fixed-skip-in-tracker:3"] {
        for clip in &clips.clips {
            if let Some(truth) = &clip.truth {
                let tracks = shown(clip, policy);
                requests.push(request(&tracks, truth));
                let judged = tracking(&tracks, truth).expect("boxes and truth name their objects");
                ours.push((format!("{policy} on {}", clip.name), judged));
            }
        }
    }
    assert_eq!(ours.len(), 3 * 17);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/tracking_scores.py");
    let theirs = answer_of(
        Command::new(crate::wheel::python()).arg(script),
        &json!(requests),
    );
    let theirs: Vec<(f64, f64)> = serde_json::from_value(theirs).expect("two figures a clip");
    assert_eq!(theirs.len(), ours.len());
    for ((what, ours), (hota, idf1)) in ours.iter().zip(theirs) {
        println!("{what}: {ours:?}");
        assert!(
            (ours.hota - hota).abs() < 1e-9,
            "{what}: {ours:?}, not HOTA {hota}"
        );
        assert!(
            (ours.idf1 - idf1).abs() < 1e-9,
            "{what}: {ours:?}, not IDF1 {idf1}"
        );
        assert!(hota > 0.1 && idf1 > 0.1, "{what}: {ours:?}");
    }
}
