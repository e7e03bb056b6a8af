//! The head of YOLOv8, YOLO11 and of YOLO26 in its one-to-many form, as Ultralytics exports them: one output
//! `[1, 4 + classes, anchors]`, decoded. The rows are centre x, centre y, width and height in input pixels, then one
//! score per class; there is no objectness. Overlaps remain to be suppressed.

use super::reading::{around, candidate, count, format, is_score, misfit, only};
use super::{Candidate, Head, Misfit, ReadOutputs, TensorView};
use crate::detector::{HeadName, PictureInput, Signature};
use crate::picture::{ColorOrder, Fit, ValueRange};
use albireo_core::detection::ClassId;

/// The box, before the class scores.
const BEFORE_CLASSES: usize = 4;

/// The number of anchors processed together, so that the scores of one class lie side by side in memory and the best so
/// far stay in the processor's cache.
const BLOCK: usize = 64;

/// The parameters for reading the output.
#[derive(Debug)]
struct Yolo {
    classes: usize,
    /// -1 if the model leaves the number open.
    anchors: i64,
}

pub(super) fn bind(signature: &Signature, input: PictureInput) -> Result<Head, Misfit> {
    let misfit = misfit(HeadName::Yolo);
    let output = signature.only_output().map_err(&misfit)?;
    match *output.shape.as_slice() {
        [1 | -1, rows, anchors]
            if count(rows) > BEFORE_CLASSES
                && count(rows) - BEFORE_CLASSES <= usize::from(u16::MAX)
                && (anchors == -1 || anchors > 0) =>
        {
            let classes = count(rows) - BEFORE_CLASSES;
            let (fit, range) = (Fit::Centre(114), ValueRange::ToOne);
            Ok(Head {
                name: HeadName::Yolo,
                classes: Some(classes),
                input_format: format(input, fit, ColorOrder::Rgb, range),
                overlaps: true,
                reader: Box::new(Yolo { classes, anchors }),
            })
        }
        _ => Err(misfit("its output has another shape".to_owned())),
    }
}

impl ReadOutputs for Yolo {
    fn read(
        &self,
        outputs: &[TensorView<'_>],
        confidence: f64,
        candidates: &mut Vec<Candidate>,
    ) -> Result<u64, String> {
        let rows = BEFORE_CLASSES + self.classes;
        let values = only(outputs, &[1, rows as i64, self.anchors])?;
        let anchors = values.len() / rows;
        let row = |number: usize| &values[number * anchors..][..anchors];
        let (center_x, center_y, width, height) = (row(0), row(1), row(2), row(3));
        let mut rejected = 0;
        for start in (0..anchors).step_by(BLOCK) {
            let length = BLOCK.min(anchors - start);
            let mut best = [(f32::NEG_INFINITY, 0_u16); BLOCK];
            let mut sound = [true; BLOCK];
            for class in 0..self.classes {
                let scores = &row(BEFORE_CLASSES + class)[start..][..length];
                for ((best, sound), &score) in best.iter_mut().zip(&mut sound).zip(scores) {
                    *sound &= is_score(score);
                    if score > best.0 {
                        *best = (score, class as u16);
                    }
                }
            }
            for place in 0..length {
                let (score, class) = best[place];
                if sound[place] && f64::from(score) < confidence {
                    continue;
                }
                let anchor = start + place;
                let corners = around(
                    f64::from(center_x[anchor]),
                    f64::from(center_y[anchor]),
                    f64::from(width[anchor]),
                    f64::from(height[anchor]),
                );
                match candidate(corners, ClassId(class), score) {
                    Some(candidate) if sound[place] => candidates.push(candidate),
                    _ => rejected += 1,
                }
            }
        }
        Ok(rejected)
    }
}
