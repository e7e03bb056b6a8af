//! The arithmetic of the DETR family with sigmoid scores: `[1, queries, 4]` boxes (centre x, centre y, width, height,
//! from 0 to 1) and `[1, queries, classes]` logits. The best pairs of query and class are kept, as many as there are
//! queries, so one query may give boxes of several classes; nothing is suppressed.

use super::dense::sigmoid;
use super::pair::are_shares;
use super::reading::{Rows, around, candidate, count, elements, is_score};
use super::suppression::keep_best;
use super::{Bound, Evidence, ReadOutputs};
use crate::onnx::{Signature, TensorSpec, TensorView};
use albireo_core::detection::ClassId;
use albireo_core::geometry::PictureSize;

/// Names of the outputs with boxes and logits in RF-DETR's exporter.
pub(super) const RF_DETR: [&str; 2] = ["dets", "labels"];

/// The same in the transformers library, and in the repositories of D-FINE and DEIM.
pub(super) const OTHERS: [[&str; 2]; 2] = [["pred_boxes", "logits"], ["pred_boxes", "pred_logits"]];

/// The parameters for reading the output.
#[derive(Debug)]
struct Detr {
    size: PictureSize,
    /// The indices of boxes and logits among the outputs.
    boxes: usize,
    logits: usize,
    /// -1 if the model leaves the number open.
    queries: i64,
    classes: usize,
}

/// Binds the outputs with the first of these `names` that the model has.
pub(super) fn bind(
    names: &[[&str; 2]],
    signature: &Signature,
    size: PictureSize,
) -> Result<Bound, String> {
    let is_there = |[boxes, logits]: &&[&str; 2]| {
        signature.output(boxes).is_ok() && signature.output(logits).is_ok()
    };
    let [name_of_boxes, name_of_logits] =
        names.iter().find(is_there).ok_or("it has no such outputs")?;
    let (boxes, of_boxes) = signature.output(name_of_boxes)?;
    let (logits, of_logits) = signature.output(name_of_logits)?;
    // The number of queries, and of the numbers for each.
    let rows = |output: &TensorSpec| match *output.shape.as_slice() {
        [1 | -1, queries, last] if queries == -1 || queries > 0 => Some((queries, count(last))),
        _ => None,
    };
    of_boxes.float()?;
    of_logits.float()?;
    match (rows(of_boxes), rows(of_logits)) {
        (Some((queries, 4)), Some((same, classes)))
            if queries == same && (1..=usize::from(u16::MAX)).contains(&classes) =>
        {
            let reader = Detr {
                size,
                boxes,
                logits,
                queries,
                classes,
            };
            Ok(Bound {
                classes: Some(classes),
                reader: Box::new(reader),
            })
        }
        _ => Err("its outputs have other shapes".to_owned()),
    }
}

impl ReadOutputs for Detr {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let (Some(boxes), Some(logits)) = (outputs.get(self.boxes), outputs.get(self.logits))
        else {
            return Err(format!(
                "the model returned outputs without boxes and logits, {} in all",
                outputs.len()
            ));
        };
        let (boxes, _) = elements(boxes, &[1, self.queries, 4])?.as_chunks::<4>();
        let queries = boxes.len();
        let logits = elements(logits, &[1, queries as i64, self.classes as i64])?;
        let input_width = f64::from(self.size.width);
        let input_height = f64::from(self.size.height);
        let are_probabilities = are_probabilities(logits);
        let least = if are_probabilities {
            rows.confidence
        } else {
            logit(rows.confidence)
        };
        let probability = |number: f32| {
            if are_probabilities {
                number
            } else {
                sigmoid(number)
            }
        };
        let mut found = Vec::new();
        for (sides, numbers) in boxes.iter().zip(logits.chunks_exact(self.classes)) {
            let before = found.len();
            let [x, y, width, height] = sides.map(f64::from);
            let corners = around([
                x * input_width,
                y * input_height,
                width * input_width,
                height * input_height,
            ]);
            let mut is_sound = true;
            for (class, &number) in numbers.iter().enumerate() {
                if f64::from(number) >= least {
                    match candidate(corners, ClassId(class as u16), probability(number)) {
                        Some(candidate) => found.push(candidate),
                        None => is_sound = false,
                    }
                }
                is_sound &= !number.is_nan();
            }
            // A query is taken whole or not at all.
            if !is_sound {
                found.truncate(before);
                rows.rejected += 1;
            }
        }
        keep_best(&mut found, queries);
        rows.candidates.append(&mut found);
        Ok(())
    }

    // Each query is another object.
    fn overlaps_in(&self, _outputs: &[TensorView<'_>]) -> bool {
        false
    }

    fn evidence(&self, outputs: &[TensorView<'_>], _confidence: f64) -> Evidence {
        let expected = [1, self.queries, self.classes as i64];
        let numbers = outputs.get(self.logits).map(|logits| elements(logits, &expected));
        let Some(Ok(numbers)) = numbers else {
            return Evidence::None;
        };
        let has_no_object = if are_probabilities(numbers) {
            are_shares(numbers, self.classes)
        } else {
            last_wins(numbers, self.classes)
        };
        if has_no_object {
            return Evidence::against_with(
                "the last of its classes wins nearly everywhere, or the scores of each box sum to 1: one class is \"no \
                 object\" by softmax (DETR itself, YOLOS), which nothing here reads",
                "Export it as final boxes with one score each, and list their columns in detector.head",
            );
        }
        Evidence::None
    }
}

/// True if these are no logits: some exports end with the sigmoid, and logits of a real run are mostly negative. A few that
/// are no probabilities are faults of their queries, and say nothing of the others.
fn are_probabilities(numbers: &[f32]) -> bool {
    let is_other = |number: &&f32| number.is_finite() && !is_score(**number);
    10 * numbers.iter().filter(is_other).count() <= numbers.len()
}

/// True if the last class is the best of nearly every query, and more likely than not: only "no object" is everywhere.
fn last_wins(logits: &[f32], classes: usize) -> bool {
    let rows = logits.chunks_exact(classes);
    let total = rows.len();
    let is_won = |row: &&[f32]| match row.split_last() {
        Some((last, others)) => {
            *last > 0.0 && !others.is_empty() && others.iter().all(|other| other < last)
        }
        None => false,
    };
    let won = rows.filter(is_won).count();
    won > 0 && 10 * won >= 9 * total
}

/// The logit of `score`: infinite for 0 and 1.
fn logit(score: f64) -> f64 {
    (score / (1.0 - score)).ln()
}
