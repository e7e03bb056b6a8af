//! HOTA and IDF1 equal those of TrackEval on the same boxes, and MOTChallenge's distractors are left out as it does.

use crate::golden_traces::replay::{Screen, decide_frame, policy};
use crate::golden_traces::shared_data::{detections, sequences};
use crate::support::{ask_script, project, scored};
use albireo_core::policy::{Outcome, Profile};
use albireo_eval::boxes::ScoredBox;
use albireo_eval::data::{Clip, mot_challenge};
use albireo_eval::judge::{Classes, Interpolation, SHOWN_CONFIDENCE, Truth, accuracy, tracking};
use rand_core::{RngCore, SeedableRng};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

/// The boxes that `policy` shows for a recording.
fn shown(clip: &Clip, asked: &str) -> Vec<Vec<ScoredBox>> {
    let mut policy = policy(asked, Profile::Paper);
    let mut outcome = Outcome::default();
    let mut boxes = Vec::new();
    for (index, found) in (0..).zip(detections(clip)) {
        let screen = Screen::NeverEmpty;
        let picture = clip.picture;
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
    let tracks: Vec<Value> = tracks.iter().map(rows).collect();
    let truth: Vec<Value> = truth.iter().map(rows).collect();
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

/// Writes a random sequence of MOTChallenge with every class and flag, and tracks of it; returns its number of frames. Some
/// frames have no objects, some no tracks.
fn write_sequence(folder: &Path, name: &str, seed: u64) -> usize {
    const FRAMES: usize = 40;
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    let mut uniform = move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let mut truth = String::new();
    let mut tracks = String::new();
    for object in 1..=30 {
        // Half are pedestrians. Files of the benchmark mark these alone with 1; distractors count as such either way.
        let class = if uniform() < 0.5 {
            1
        } else {
            1 + (uniform() * 13.0) as u32
        };
        let is_judged = match class {
            1 => uniform() < 0.9,
            2 | 7 | 8 | 12 => uniform() < 0.5,
            _ => false,
        };
        let (x, y) = (1.0 + uniform() * 300.0, 1.0 + uniform() * 200.0);
        let (w, h) = (20.0 + uniform() * 40.0, 40.0 + uniform() * 60.0);
        for frame in 1..=FRAMES {
            if frame % 10 == 0 {
                continue;
            }
            let left = x + frame as f64;
            let flag = u8::from(is_judged);
            writeln!(
                truth,
                "{frame},{object},{left},{y},{w},{h},{flag},{class},1"
            )
            .unwrap();
            // Some objects have a second track close by.
            for track in [object, object + 100] {
                let is_found = uniform() < if track == object { 0.8 } else { 0.3 };
                if is_found && frame % 7 != 0 {
                    let left = left + (uniform() - 0.5) * 20.0;
                    writeln!(tracks, "{frame},{track},{left},{y},{w},{h},0.9,-1,-1,-1").unwrap();
                }
            }
        }
    }
    let sequence = folder.join("gt").join(name);
    std::fs::create_dir_all(sequence.join("gt")).unwrap();
    std::fs::create_dir_all(folder.join("tracks/ours")).unwrap();
    std::fs::write(sequence.join("gt/gt.txt"), truth).unwrap();
    std::fs::write(folder.join(format!("tracks/ours/{name}.txt")), tracks).unwrap();
    let info = format!(
        "[Sequence]\nname={name}\nimDir=img1\nframeRate=30\nseqLength={FRAMES}\nimWidth=640\nimHeight=480\n"
    );
    std::fs::write(sequence.join("seqinfo.ini"), info).unwrap();
    FRAMES
}

/// The tracks of a sequence as boxes; files count pixels from 1.
fn written_tracks(folder: &Path, name: &str, frames: usize) -> Vec<Vec<ScoredBox>> {
    let text = std::fs::read_to_string(folder.join(format!("tracks/ours/{name}.txt"))).unwrap();
    let mut boxes = vec![Vec::new(); frames];
    for line in text.lines() {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let [left, top] = [cells[2] - 1.0, cells[3] - 1.0];
        boxes[cells[0] as usize - 1].push(ScoredBox {
            object: Some(cells[1] as u64),
            ..scored([left, top, left + cells[4], top + cells[5]], 0, cells[6])
        });
    }
    boxes
}

#[rstest::rstest]
#[ignore = "needs the wheel"]
fn wheel_tracks_on_distractors_are_left_out_as_in_trackeval(
    #[values("MOT17", "MOT20")] benchmark: &str,
) {
    let folder = tempfile::tempdir().unwrap();
    let names: Vec<String> = (1..=6).map(|number| format!("{benchmark}-0{number}")).collect();
    let frames: Vec<usize> = (1..)
        .zip(&names)
        .map(|(seed, name)| write_sequence(folder.path(), name, seed))
        .collect();
    let lengths: serde_json::Map<String, Value> = names
        .iter()
        .zip(&frames)
        .map(|(name, frames)| (name.clone(), json!(frames)))
        .collect();
    let mut script = Command::new(crate::wheel::python());
    script.arg(project("tests/python/mot_challenge_scores.py"));
    let request = json!({"folder": folder.path(), "benchmark": benchmark, "sequences": lengths});
    let theirs = ask_script(&mut script, &request);
    let theirs: Vec<(f64, f64, usize)> = serde_json::from_value(theirs).unwrap();
    let clips = mot_challenge::read(&folder.path().join("gt")).unwrap().clips;
    assert_eq!((theirs.len(), clips.len()), (6, 6));
    for (clip, (hota, idf1, judged)) in clips.iter().zip(theirs) {
        let tracks = written_tracks(folder.path(), &clip.name, clip.frames);
        let truth = Truth {
            objects: clip.truth.as_deref().unwrap(),
            ignored: &clip.ignored,
        };
        let ours = tracking(&tracks, truth).unwrap();
        for (ours, theirs) in [(ours.hota, hota), (ours.idf1, idf1)] {
            assert!(
                (ours - theirs).abs() < 1e-9,
                "{}: {ours}, not {theirs}",
                clip.name
            );
        }
        let found = accuracy(&tracks, truth, Classes::Pooled, Interpolation::AllPoints);
        assert_eq!(found.unwrap().predictions, judged, "{}", clip.name);
        let all: usize = tracks.iter().map(Vec::len).sum();
        assert!(judged < all, "{}: no distractor was found", clip.name);
    }
}
