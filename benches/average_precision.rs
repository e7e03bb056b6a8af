//! Processor time of average precision (AP@50 and mAP@50:95, classes pooled) over 10⁴, 10⁵ and 10⁶ predictions with as
//! many ground-truth boxes. Prints a table in Markdown.
//!
//! `cargo bench --bench average_precision`

use albireo_eval::boxes::ScoredBox;
use albireo_eval::judge::{Classes, Interpolation, accuracy};
use albireo_scene::{PICTURE, Scene, processor_seconds, quartiles};
use std::hint::black_box;

const BOXES: [usize; 3] = [10_000, 100_000, 1_000_000];
const BOXES_A_FRAME: [usize; 2] = [10, 100];
const ROUNDS: usize = 7;

fn boxes(count: usize, a_frame: usize) -> (Vec<Vec<ScoredBox>>, Vec<Vec<ScoredBox>>) {
    let mut scene = Scene::new(a_frame);
    let truth = scene.film(count / a_frame, 0);
    let mut scores = Scene::new(0);
    let found = truth
        .iter()
        .map(|frame| {
            let boxes = frame.iter().map(|detection| {
                let mut corners = detection.bounding_box.pixel_corners(PICTURE);
                // Shifted by up to a third of the width, so that some match at every threshold and some at none.
                let off = scores.between(-0.33, 0.33) * (corners.x2 - corners.x1);
                corners.x1 += off;
                corners.x2 += off;
                ScoredBox {
                    corners,
                    class: detection.class,
                    confidence: scores.between(0.0, 1.0),
                    object: None,
                }
            });
            boxes.collect()
        })
        .collect();
    let truth = truth
        .iter()
        .map(|frame| {
            let boxes = frame.iter().map(|detection| ScoredBox {
                corners: detection.bounding_box.pixel_corners(PICTURE),
                class: detection.class,
                confidence: 1.0,
                object: None,
            });
            boxes.collect()
        })
        .collect();
    (found, truth)
}

fn main() {
    println!("Processor time, median of {ROUNDS} rounds, ms; in brackets ns a predicted box\n");
    println!(
        "| boxes a frame | 10⁴ | 10⁵ | 10⁶ | 10⁶ against 10⁵ |\n| --- | --- | --- | --- | --- |"
    );
    for a_frame in BOXES_A_FRAME {
        let cases = BOXES.map(|count| boxes(count, a_frame));
        let mut times = BOXES.map(|_| Vec::new());
        for _ in 0..ROUNDS {
            for ((found, truth), times) in cases.iter().zip(&mut times) {
                let begin = processor_seconds();
                let judged = accuracy(found, truth, Classes::Pooled, Interpolation::AllPoints);
                times.push(processor_seconds() - begin);
                assert!(black_box(judged).is_some_and(|judged| judged.ap50 > 0.1));
            }
        }
        let medians = times.map(|times| quartiles(times)[1]);
        let cells: Vec<_> = medians
            .iter()
            .zip(BOXES)
            .map(|(time, count)| format!("{:.1} ({:.0})", time * 1e3, time * 1e9 / count as f64))
            .collect();
        println!(
            "| {a_frame} | {} | {:.1}× |",
            cells.join(" | "),
            medians[2] / medians[1]
        );
    }
}
