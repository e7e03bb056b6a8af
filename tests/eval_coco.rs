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
    let scored_row = |found: &ScoredBox| {
        let c = found.corners;
        json!([c.x1, c.y1, c.x2, c.y2, found.class.0, found.confidence])
    };
    let ignored_row = |ignored: &Ignored| {
        let c = ignored.corners;
        let kind = match ignored.mark {
            Mark::Crowd => "crowd",
            _ => "object",
        };
        json!([c.x1, c.y1, c.x2, c.y2, ignored.class.unwrap().0, kind])
    };
    let mut frames = Vec::new();
    for (index, (predictions, truth)) in case.predictions.iter().zip(&case.truth).enumerate() {
        let predictions: Vec<Value> = predictions.iter().map(scored_row).collect();
        let truth: Vec<Value> = truth.iter().map(scored_row).collect();
        let ignored = case.ignored.get(index).into_iter().flatten();
        let ignored: Vec<Value> = ignored.map(ignored_row).collect();
        frames.push(json!({"predictions": predictions, "truth": truth, "ignored": ignored}));
    }
    frames.into()
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
                let what = format!("{} {name} {figure}", case.name);
                let difference = (value - expected).abs();
                assert!(difference < 1e-6, "{what}: {value}, {expected}");
            }
        }
    }
}

/// Whether some objects of a case are ignored, and there are crowds.
#[derive(Clone, Copy)]
enum Marks {
    None,
    Some,
}

/// Random boxes of three classes on 60 frames, some without any.
fn random_case(seed: u64, marks: Marks) -> Case {
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
            let kind = match marks {
                Marks::None => 1.0,
                Marks::Some => uniform(),
            };
            let is_crowd = kind < 0.1;
            if kind < 0.25 {
                let mark = if is_crowd { Mark::Crowd } else { Mark::Object };
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
                let part = if is_crowd { 0.3 + 0.7 * uniform() } else { 1.0 };
                let exact = [x, y, x + part * w, y + part * h];
                let [x1, y1, x2, y2] = exact.map(|side| side + (uniform() - 0.5) * 16.0);
                let class = if uniform() < 0.9 { class } else { 1 };
                // The part of a crowd may have been cut to nothing.
                if x2 - x1 > 1.0 && y2 - y1 > 1.0 {
                    found.push(scored([x1, y1, x2, y2], class, uniform()));
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
    assert_agreement(&[random_case(7, Marks::None)]);
}

#[test]
#[ignore = "needs Python"]
fn python_crowds_and_ignored_objects_are_judged_as_in_pycocotools() {
    let cases: Vec<Case> = (1..=5).map(|seed| random_case(seed, Marks::Some)).collect();
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
