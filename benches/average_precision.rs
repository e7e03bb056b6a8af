//! Processor time of average precision (AP@50 and mAP@50:95, classes pooled) over 10⁴, 10⁵ and 10⁶ predictions with as
//! many ground-truth boxes. Prints a table in Markdown.
//!
//! `cargo bench --bench average_precision`

use albireo_eval::boxes::ScoredBox;
use albireo_eval::judge::{Classes, Interpolation, accuracy};
use albireo_scene::{PICTURE, Scene, processor_seconds, quartiles};
use std::hint::black_box;

/// Numbers of predictions.
const BOXES: [usize; 3] = [10_000, 100_000, 1_000_000];
const BOXES_A_FRAME: [usize; 2] = [10, 100];
const ROUNDS: usize = 7;

/// The boxes of a film, frame by frame.
#[derive(Default)]
struct Film {
    found: Vec<Vec<ScoredBox>>,
    truth: Vec<Vec<ScoredBox>>,
}

fn film(count: usize, a_frame: usize) -> Film {
    let mut film = Film::default();
    let mut noise = Scene::new(0);
    for frame in Scene::new(a_frame).film(count / a_frame, 0) {
        let mut found = Vec::with_capacity(a_frame);
        let mut truth = Vec::with_capacity(a_frame);
        for detection in &frame {
            let true_box = ScoredBox {
                corners: detection.bounding_box.pixel_corners(PICTURE),
                class: detection.class,
                confidence: 1.0,
                object: None,
            };
            let mut corners = true_box.corners;
            // Shifted by up to a third of the width, so that some match at every threshold and some at none.
            let off = noise.between(-0.33, 0.33) * (corners.x2 - corners.x1);
            corners.x1 += off;
            corners.x2 += off;
            let confidence = noise.between(0.0, 1.0);
            found.push(ScoredBox {
                corners,
                confidence,
                ..true_box
            });
            truth.push(true_box);
        }
        film.found.push(found);
        film.truth.push(truth);
    }
    film
}

fn main() {
    println!("Processor time, median of {ROUNDS} rounds, ms; in brackets ns a predicted box\n");
    println!(
        "| boxes a frame | 10⁴ | 10⁵ | 10⁶ | 10⁶ against 10⁵ |\n| --- | --- | --- | --- | --- |"
    );
    for a_frame in BOXES_A_FRAME {
        let films = BOXES.map(|count| film(count, a_frame));
        let mut times = BOXES.map(|_| Vec::new());
        for _ in 0..ROUNDS {
            for (film, times) in films.iter().zip(&mut times) {
                let begin = processor_seconds();
                let judged = accuracy(
                    &film.found,
                    &film.truth,
                    Classes::Pooled,
                    Interpolation::AllPoints,
                );
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
