//! The arithmetic of YOLOv8 and its successors, as Ultralytics exports them: one output `[1, 4 + classes, anchors]`. The
//! rows are centre x, centre y, width and height, then one score per class; there is no objectness.

use super::ReadOutputs;
use super::dense::{are_logits, sigmoid};
use super::reading::{Rows, around, candidate, elements, is_score, unit};
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

impl ReadOutputs for Yolo {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let numbers = BEFORE_CLASSES + self.classes;
        let output = outputs
            .get(self.output)
            .ok_or_else(|| format!("the model returned {} outputs", outputs.len()))?;
        let values = elements(output, &[1, numbers as i64, self.anchors])?;
        let anchors = values.len() / numbers;
        let row = |number: usize| &values[number * anchors..][..anchors];
        let sides = [row(0), row(1), row(2), row(3)];
        let mut largest = 0.0_f32;
        for side in sides.into_iter().flatten() {
            if side.is_finite() {
                largest = largest.max(side.abs());
            }
        }
        let unit = unit(f64::from(largest), self.size);
        let has_logits = are_logits(row(BEFORE_CLASSES).iter().copied());
        for start in (0..anchors).step_by(BLOCK) {
            let length = BLOCK.min(anchors - start);
            let scores_of = |class: usize| &row(BEFORE_CLASSES + class)[start..][..length];
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
                let corners = around(sides.map(|row| f64::from(row[start + place])));
                rows.add(candidate(unit.pixels(corners), ClassId(class), score));
            }
        }
        Ok(())
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
