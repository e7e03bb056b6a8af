//! The head of RF-DETR and other models of the DETR family with sigmoid scores: `[1, queries, 4]` boxes (centre x,
//! centre y, width, height, from 0 to 1) and `[1, queries, classes]` logits. The best pairs of query and class are
//! kept, as many as there are queries, so one query may give boxes of several classes; nothing is suppressed. The
//! picture is stretched to the input and normalised as for ImageNet.

use super::reading::{Rows, around, candidate, count, elements};
use super::suppression::keep_best;
use super::{Bound, ReadOutputs, TensorView};
use crate::detector::{Signature, TensorSpec};
use albireo_core::detection::ClassId;
use albireo_core::geometry::PictureSize;

/// Names of the outputs with boxes and logits, in RF-DETR's exporter and in the Transformers library.
const NAMES: [[&str; 2]; 2] = [["dets", "labels"], ["pred_boxes", "logits"]];

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

pub(super) fn bind(signature: &Signature, size: PictureSize) -> Bound {
    let ((boxes, dets), (logits, labels)) = NAMES
        .iter()
        .find_map(|[boxes, logits]| {
            Some((
                signature.output(boxes).ok()?,
                signature.output(logits).ok()?,
            ))
        })
        .ok_or("it has no such outputs")?;
    let sides = |output: &TensorSpec| match *output.shape.as_slice() {
        [1 | -1, queries, last] if queries == -1 || queries > 0 => Some((queries, count(last))),
        _ => None,
    };
    match (sides(dets), sides(labels)) {
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
            Ok((Some(classes), Box::new(reader)))
        }
        _ => Err("its outputs have other shapes".to_owned()),
    }
}

/// True if the outputs have RF-DETR's names, so that its scores and colours are known to apply.
pub(super) fn is_named(signature: &Signature) -> bool {
    let [boxes, logits] = NAMES[0];
    signature.output(boxes).is_ok() && signature.output(logits).is_ok()
}

impl ReadOutputs for Detr {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let (Some(boxes), Some(logits)) = (outputs.get(self.boxes), outputs.get(self.logits))
        else {
            return Err(format!(
                "the model returned {} outputs instead of boxes and logits",
                outputs.len()
            ));
        };
        let boxes = elements(boxes, &[1, self.queries, 4])?;
        let queries = boxes.len() / 4;
        let logits = elements(logits, &[1, queries as i64, self.classes as i64])?;
        let (width, height) = (f64::from(self.size.width), f64::from(self.size.height));
        let least = logit(rows.confidence);
        let mut found = Vec::new();
        for (sides, logits) in boxes.chunks_exact(4).zip(logits.chunks_exact(self.classes)) {
            let before = found.len();
            let corners = around([
                f64::from(sides[0]) * width,
                f64::from(sides[1]) * height,
                f64::from(sides[2]) * width,
                f64::from(sides[3]) * height,
            ]);
            let sound = logits.iter().enumerate().all(|(class, &logit)| {
                if f64::from(logit) >= least {
                    match candidate(corners, ClassId(class as u16), sigmoid(logit)) {
                        Some(candidate) => found.push(candidate),
                        None => return false,
                    }
                }
                !logit.is_nan()
            });
            if !sound {
                found.truncate(before);
                rows.rejected += 1;
            }
        }
        keep_best(&mut found, queries);
        rows.candidates.append(&mut found);
        Ok(())
    }
}

fn sigmoid(logit: f32) -> f32 {
    1.0 / (1.0 + (-logit).exp())
}

/// The logit of `score`: infinite for 0 and 1.
fn logit(score: f64) -> f64 {
    (score / (1.0 - score)).ln()
}
