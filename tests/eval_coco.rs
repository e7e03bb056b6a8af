//! Average precision is what COCO's own tool computes on the same boxes, where the definitions coincide.
//!
//! These tests need the Python environment of tests/requirements.txt at .cache/python.
#![allow(clippy::expect_used)]

use crate::support::{answer_of, python, shared};
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;
use albireo_eval::average_precision::{Accuracy, Classes, Interpolation, ScoredBox, accuracy};
use albireo_eval::data::recorded;
use rand_core::{RngCore, SeedableRng};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;

/// A name, predictions and ground truth.
type Case = (String, Vec<Vec<ScoredBox>>, Vec<Vec<ScoredBox>>);

/// What pycocotools says about these boxes, one answer a case.
fn coco(cases: &[Case]) -> Value {
    let clips: Vec<Value> = cases.iter().map(frames).collect();
    let request = json!({"clips": clips});
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let script = root.join("tests/python/coco_average_precision.py");
    answer_of(Command::new(python()).arg(script), &request)
}

/// A case in the form the script takes.
fn frames((_, predictions, truth): &Case) -> Value {
    let numbers = |c: Corners| [c.x1, c.y1, c.x2, c.y2];
    let frames = predictions.iter().zip(truth).map(|(predictions, truth)| {
        let predictions = predictions.iter().map(|p| {
            let [x1, y1, x2, y2] = numbers(p.corners);
            json!([x1, y1, x2, y2, p.class.0, p.confidence])
        });
        let truth = truth.iter().map(|t| {
            let [x1, y1, x2, y2] = numbers(t.corners);
            json!([x1, y1, x2, y2, t.class.0])
        });
        json!({
            "predictions": predictions.collect::<Vec<_>>(),
            "truth": truth.collect::<Vec<_>>(),
        })
    });
    frames.collect()
}

fn assert_agreement(cases: &[Case]) {
    let answers = coco(cases);
    for (index, (what, predictions, truth)) in cases.iter().enumerate() {
        compare(what, predictions, truth, &answers[index]);
    }
}

fn compare(what: &str, predictions: &[Vec<ScoredBox>], truth: &[Vec<ScoredBox>], theirs: &Value) {
    for (name, classes, interpolation) in [
        (
            "pooled_all_points",
            Classes::Pooled,
            Interpolation::AllPoints,
        ),
        ("pooled_101", Classes::Pooled, Interpolation::Coco101),
        ("separate_101", Classes::Separate, Interpolation::Coco101),
    ] {
        let ours: Accuracy =
            accuracy(predictions, truth, classes, interpolation).expect("there is ground truth");
        for (figure, value) in [("ap50", ours.ap50), ("map", ours.map)] {
            let expected = theirs[name][figure].as_f64().expect("a number");
            assert!(
                (value - expected).abs() < 1e-6,
                "{what} {name} {figure}: {value}, pycocotools {expected}"
            );
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
            let class = ClassId((uniform() * 3.0) as u16);
            let corners = Corners {
                x1: x,
                y1: y,
                x2: x + w,
                y2: y + h,
            };
            there.push(ScoredBox {
                corners,
                class,
                confidence: 1.0,
                object: None,
            });
            // Most are found, roughly, some twice, some under a wrong name.
            while uniform() < 0.6 {
                let mut near = || (uniform() - 0.5) * 16.0;
                let corners = Corners {
                    x1: x + near(),
                    y1: y + near(),
                    x2: x + w + near(),
                    y2: y + h + near(),
                };
                let class = if uniform() < 0.9 { class } else { ClassId(1) };
                found.push(ScoredBox {
                    corners,
                    class,
                    confidence: uniform(),
                    object: None,
                });
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
    let clips = recorded::read(&shared("data/recorded")).expect("the recordings");
    let mut cases: Vec<Case> = Vec::new();
    for clip in &clips.clips {
        let (Some(detections), Some(truth)) = (&clip.detections, &clip.truth) else {
            continue;
        };
        // pycocotools takes seconds for a long clip.
        if clip.frames > 300 {
            continue;
        }
        let predictions: Vec<Vec<ScoredBox>> = detections
            .iter()
            .map(|frame| {
                let boxes = frame.iter().map(|detection| ScoredBox {
                    corners: detection.corners,
                    class: detection.class,
                    confidence: detection.confidence,
                    object: None,
                });
                boxes.collect()
            })
            .collect();
        cases.push((clip.name.clone(), predictions, truth.clone()));
    }
    assert_eq!(cases.len(), 8);
    assert_agreement(&cases);
}
