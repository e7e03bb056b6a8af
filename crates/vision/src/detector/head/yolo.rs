//! The arithmetic of YOLOv8 and its successors, as Ultralytics exports them: one output `[1, 4 + classes, anchors]`. The
//! rows are centre x, centre y, width and height, then one score per class; there is no objectness.

use super::dense::{are_logits, sigmoid};
use super::reading::{
    Rows, are_corners, around, candidate, corners_not_centres, elements, is_score, unit,
};
use super::{Evidence, ReadOutputs};
use crate::onnx::TensorView;
use albireo_core::detection::ClassId;
use albireo_core::geometry::PictureSize;

/// The box, before the class scores.
pub(super) const BEFORE_CLASSES: usize = 4;

/// The number of anchors processed together, so that the scores of one class lie side by side in memory and the best so
/// far stay in the processor's cache.
const BLOCK: usize = 64;

/// The parameters for reading the output.
#[derive(Debug)]
pub(super) struct Yolo {
    pub(super) size: PictureSize,
    pub(super) output: usize,
    pub(super) classes: usize,
    /// -1 if the model leaves the number open.
    pub(super) anchors: i64,
}

/// The values of one run: a row per number, with a column per anchor.
struct NumberRows<'a> {
    values: &'a [f32],
    anchors: usize,
}

impl<'a> NumberRows<'a> {
    fn row(&self, number: usize) -> &'a [f32] {
        &self.values[number * self.anchors..][..self.anchors]
    }

    /// The box of this anchor: centre x, centre y, width, height.
    fn sides(&self, anchor: usize) -> [f64; 4] {
        [0, 1, 2, 3].map(|number| f64::from(self.values[number * self.anchors + anchor]))
    }

    fn boxes(&self) -> impl Iterator<Item = [f64; 4]> {
        (0..self.anchors).map(move |anchor| self.sides(anchor))
    }
}

impl Yolo {
    fn rows<'a>(&self, outputs: &[TensorView<'a>]) -> Result<NumberRows<'a>, String> {
        let numbers = BEFORE_CLASSES + self.classes;
        let output = outputs
            .get(self.output)
            .ok_or_else(|| format!("the model returned {} outputs", outputs.len()))?;
        let values = elements(output, &[1, numbers as i64, self.anchors])?;
        Ok(NumberRows {
            values,
            anchors: values.len() / numbers,
        })
    }
}

impl ReadOutputs for Yolo {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let run = self.rows(outputs)?;
        let unit = unit(run.boxes(), self.size);
        let has_logits = are_logits(run.row(BEFORE_CLASSES).iter().copied());
        for start in (0..run.anchors).step_by(BLOCK) {
            let length = BLOCK.min(run.anchors - start);
            let scores_of = |class: usize| &run.row(BEFORE_CLASSES + class)[start..][..length];
            let by_class = (0..self.classes).map(scores_of);
            // A logit that is not finite is a fault like a probability that is none.
            let (best, sound) = if has_logits {
                best_of_block(by_class, f32::is_finite)
            } else {
                best_of_block(by_class, is_score)
            };
            for place in 0..length {
                if !sound[place] {
                    rows.add(None);
                    continue;
                }
                let (highest, class) = best[place];
                let score = if has_logits {
                    sigmoid(highest)
                } else {
                    highest
                };
                if f64::from(score) < rows.confidence {
                    continue;
                }
                let corners = around(run.sides(start + place));
                rows.add(candidate(unit.pixels(corners), ClassId(class), score));
            }
        }
        Ok(())
    }

    fn evidence(&self, outputs: &[TensorView<'_>], _confidence: f64) -> Evidence {
        let Ok(run) = self.rows(outputs) else {
            return Evidence::None;
        };
        let unit = unit(run.boxes(), self.size);
        if are_corners(run.boxes(), unit, self.size) {
            return corners_not_centres();
        }
        Evidence::None
    }
}

/// The best score of each anchor of a block with its class, and whether all its scores are sound. `by_class` has the
/// scores of the block for one class after the other.
fn best_of_block<'a>(
    by_class: impl Iterator<Item = &'a [f32]>,
    is_sound: impl Fn(f32) -> bool,
) -> ([(f32, u16); BLOCK], [bool; BLOCK]) {
    let mut best = [(f32::NEG_INFINITY, 0_u16); BLOCK];
    let mut sound = [true; BLOCK];
    for (class, scores) in by_class.enumerate() {
        for ((best, sound), &score) in best.iter_mut().zip(&mut sound).zip(scores) {
            *sound &= is_sound(score);
            let (highest, _) = *best;
            if score > highest {
                *best = (score, class as u16);
            }
        }
    }
    (best, sound)
}
