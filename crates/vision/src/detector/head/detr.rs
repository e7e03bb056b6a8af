//! The arithmetic of the DETR family with sigmoid scores: `[1, queries, 4]` boxes (centre x, centre y, width, height,
//! from 0 to 1) and `[1, queries, classes]` logits. The best pairs of query and class are kept, as many as there are
//! queries, so one query may give boxes of several classes; nothing is suppressed.

use super::dense::sigmoid;
use super::reading::{Rows, around, candidate, count, elements};
use super::suppression::keep_best;
use super::{Bound, ReadOutputs};
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
                overlaps: false,
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
        // Some exports end with the sigmoid. Logits of a real run are mostly negative.
        let are_probabilities = logits.iter().all(|&number| (0.0..=1.0).contains(&number));
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
}

/// The logit of `score`: infinite for 0 and 1.
fn logit(score: f64) -> f64 {
    (score / (1.0 - score)).ln()
}
