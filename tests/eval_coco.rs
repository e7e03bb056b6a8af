//! Average precision equals that of COCO's own tool on the same boxes, where the definitions coincide.
//!
//! These tests need the Python environment of tests/requirements.txt at .cache/python.

use crate::golden_traces::shared_data::sequences;
use crate::support::{ask_script, project, python, scored};
use albireo_eval::boxes::ScoredBox;
use albireo_eval::judge::Classes::{Pooled, Separate};
use albireo_eval::judge::Interpolation::{AllPoints, Coco101};
use albireo_eval::judge::{Ignored, Mark, Truth, accuracy};
use rand_core::{RngCore, SeedableRng};
use serde_json::{Value, json};
use std::process::Command;

/// Boxes to judge.
struct Case {
    name: String,
    predictions: Vec<Vec<ScoredBox>>,
    truth: Vec<Vec<ScoredBox>>,
    ignored: Vec<Vec<Ignored>>,
}

/// A case in the format of the script.
fn frames(case: &Case) -> Value {
    let row = |b: &ScoredBox| {
        let c = b.corners;
        json!([c.x1, c.y1, c.x2, c.y2, b.class.0, b.confidence])
    };
    let marked = |ignored: &Ignored| {
        let c = ignored.corners;
        let kind = if ignored.mark == Mark::Crowd {
            "crowd"
        } else {
            "object"
        };
        json!([c.x1, c.y1, c.x2, c.y2, ignored.class.unwrap().0, kind])
    };
    let frames = case.predictions.iter().zip(&case.truth).enumerate().map(|(index, boxes)| {
        let predictions: Vec<Value> = boxes.0.iter().map(row).collect();
        let truth: Vec<Value> = boxes.1.iter().map(row).collect();
        let ignored: Vec<Value> =
            case.ignored.get(index).into_iter().flatten().map(marked).collect();
        json!({"predictions": predictions, "truth": truth, "ignored": ignored})
    });
    frames.collect()
}

fn assert_agreement(cases: &[Case]) {
    let clips: Vec<Value> = cases.iter().map(frames).collect();
    let mut script = Command::new(python());
    script.arg(project("tests/python/coco_average_precision.py"));
    let answers = ask_script(&mut script, &json!({"clips": clips}));
    let answers = answers.as_array().expect("answers");
    for (case, theirs) in cases.iter().zip(answers) {
        let truth = Truth {
            objects: &case.truth,
            ignored: &case.ignored,
        };
        for (name, classes, interpolation) in [
            ("pooled_all_points", Pooled, AllPoints),
            ("pooled_101", Pooled, Coco101),
            ("separate_101", Separate, Coco101),
        ] {
            let ours = accuracy(&case.predictions, truth, classes, interpolation)
                .expect("there is ground truth");
            for (figure, value) in [("ap50", ours.ap50), ("map", ours.map)] {
                let expected = theirs[name][figure].as_f64().expect("a number");
                let off = (value - expected).abs();
                assert!(
                    off < 1e-6,
                    "{} {name} {figure}: {value}, {expected}",
                    case.name
                );
            }
        }
    }
}

/// Random boxes of three classes on 60 frames, some without any. `marked`: some objects are ignored, and there are crowds.
fn random_case(seed: u64, marked: bool) -> Case {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    let mut uniform = move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let mut case = Case {
        name: format!("random boxes {seed}"),
        predictions: Vec::new(),
        truth: Vec::new(),
        ignored: Vec::new(),
    };
    for _ in 0..60 {
        let mut found = Vec::new();
        let mut there = Vec::new();
        let mut ignored = Vec::new();
        for _ in 0..(uniform() * 12.0) as usize {
            let (x, y) = (uniform() * 300.0, uniform() * 200.0);
            let (w, h) = (20.0 + uniform() * 80.0, 20.0 + uniform() * 80.0);
            let class = (uniform() * 3.0) as u16;
            let sides = [x, y, x + w, y + h];
            let known = scored(sides, class, 1.0);
            let kind = if marked { uniform() } else { 1.0 };
            if kind < 0.25 {
                let mark = if kind < 0.1 {
                    Mark::Crowd
                } else {
                    Mark::Object
                };
                ignored.push(Ignored {
                    corners: known.corners,
                    class: Some(known.class),
                    mark,
                });
            } else {
                there.push(known);
            }
            // Most are found, roughly, some twice, some with a wrong class; in a crowd, parts of it.
            while uniform() < 0.6 {
                let part = if kind < 0.1 {
                    0.3 + 0.7 * uniform()
                } else {
                    1.0
                };
                let near = [x, y, x + part * w, y + part * h];
                let near = near.map(|side| side + (uniform() - 0.5) * 16.0);
                let class = if uniform() < 0.9 { class } else { 1 };
                // The part of a crowd may have been cut to nothing.
                if near[2] - near[0] > 1.0 && near[3] - near[1] > 1.0 {
                    found.push(scored(near, class, uniform()));
                }
            }
        }
        case.predictions.push(found);
        case.truth.push(there);
        case.ignored.push(ignored);
    }
    case
}

#[test]
#[ignore = "needs Python"]
fn python_random_boxes_of_three_classes_score_as_in_pycocotools() {
    assert_agreement(&[random_case(7, false)]);
}

#[test]
#[ignore = "needs Python"]
fn python_crowds_and_ignored_objects_are_judged_as_in_pycocotools() {
    let cases: Vec<Case> = (1..=5).map(|seed| random_case(seed, true)).collect();
    let marked = cases.iter().flat_map(|case| &case.ignored).flatten();
    let crowds = marked.clone().filter(|marked| marked.mark == Mark::Crowd).count();
    assert!(crowds > 50 && marked.count() > 2 * crowds);
    assert_agreement(&cases);
}

#[test]
#[ignore = "needs ../shared and Python"]
fn shared_python_recorded_detections_score_as_in_pycocotools() {
    // pycocotools takes seconds for a long clip.
    let short = sequences().into_iter().filter(|clip| clip.frames <= 300);
    let cases: Vec<Case> = short
        .filter_map(|clip| {
            Some(Case {
                name: clip.name,
                predictions: clip.detections?,
                truth: clip.truth?,
                ignored: Vec::new(),
            })
        })
        .collect();
    assert_eq!(cases.len(), 8);
    assert_agreement(&cases);
}
