//! Average precision equals that of COCO's own tool on the same boxes, where the definitions coincide.
//!
//! These tests need the Python environment of tests/requirements.txt at .cache/python.

use crate::golden_traces::shared_data::sequences;
use crate::support::{ask_script, project, python, scored};
use albireo_eval::boxes::ScoredBox;
use albireo_eval::judge::Classes::{Pooled, Separate};
use albireo_eval::judge::Interpolation::{AllPoints, Coco101};
use albireo_eval::judge::accuracy;
use rand_core::{RngCore, SeedableRng};
use serde_json::{Value, json};
use std::process::Command;

/// A name, predictions and ground truth.
type Case = (String, Vec<Vec<ScoredBox>>, Vec<Vec<ScoredBox>>);

/// A case in the format of the script.
fn frames((_, predictions, truth): &Case) -> Value {
    let row = |b: &ScoredBox| {
        let c = b.corners;
        json!([c.x1, c.y1, c.x2, c.y2, b.class.0, b.confidence])
    };
    let frames = predictions.iter().zip(truth).map(|(predictions, truth)| {
        let [predictions, truth] =
            [predictions, truth].map(|boxes| boxes.iter().map(row).collect::<Vec<_>>());
        json!({"predictions": predictions, "truth": truth})
    });
    frames.collect()
}

fn assert_agreement(cases: &[Case]) {
    let clips: Vec<Value> = cases.iter().map(frames).collect();
    let mut script = Command::new(python());
    script.arg(project("tests/python/coco_average_precision.py"));
    let answers = ask_script(&mut script, &json!({"clips": clips}));
    let answers = answers.as_array().expect("answers");
    for ((what, predictions, truth), theirs) in cases.iter().zip(answers) {
        for (name, classes, interpolation) in [
            ("pooled_all_points", Pooled, AllPoints),
            ("pooled_101", Pooled, Coco101),
            ("separate_101", Separate, Coco101),
        ] {
            let ours = accuracy(predictions, truth, classes, interpolation);
            let ours = ours.expect("there is ground truth");
            for (figure, value) in [("ap50", ours.ap50), ("map", ours.map)] {
                let expected = theirs[name][figure].as_f64().expect("a number");
                let off = (value - expected).abs();
                assert!(off < 1e-6, "{what} {name} {figure}: {value}, {expected}");
            }
        }
    }
}

#[test]
#[ignore = "needs Python"]
fn python_random_boxes_of_three_classes_score_as_in_pycocotools() {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(7);
    let mut uniform = move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let (mut predictions, mut truth) = (Vec::new(), Vec::new());
    for _ in 0..60 {
        let (mut found, mut there) = (Vec::new(), Vec::new());
        for _ in 0..(uniform() * 12.0) as usize {
            let (x, y) = (uniform() * 300.0, uniform() * 200.0);
            let (w, h) = (20.0 + uniform() * 80.0, 20.0 + uniform() * 80.0);
            let class = (uniform() * 3.0) as u16;
            let sides = [x, y, x + w, y + h];
            there.push(scored(sides, class, 1.0));
            // Most are found, roughly, some twice, some with a wrong class.
            while uniform() < 0.6 {
                let near = sides.map(|side| side + (uniform() - 0.5) * 16.0);
                let class = if uniform() < 0.9 { class } else { 1 };
                found.push(scored(near, class, uniform()));
            }
        }
        predictions.push(found);
        truth.push(there);
    }
    assert_agreement(&[("random boxes".to_owned(), predictions, truth)]);
}

#[test]
#[ignore = "needs ../shared and Python"]
fn shared_python_recorded_detections_score_as_in_pycocotools() {
    // pycocotools takes seconds for a long clip.
    let short = sequences().into_iter().filter(|clip| clip.frames <= 300);
    let cases = short.filter_map(|clip| Some((clip.name, clip.detections?, clip.truth?)));
    let cases: Vec<Case> = cases.collect();
    assert_eq!(cases.len(), 8);
    assert_agreement(&cases);
}
