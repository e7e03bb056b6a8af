//! The head of models that output final boxes (YOLO26, YOLOv10, and exports with suppression inside): one output
//! `[1, boxes, 6]`, each row x1, y1, x2, y2 in input pixels, score, class. Nothing is left to suppress.

use super::reading::{candidate, corners, count, format, is_score, misfit, only};
use super::{Candidate, Head, Misfit, ReadOutputs, TensorView};
use crate::detector::{HeadName, PictureInput, Signature};
use crate::picture::{ColorOrder, Fit, ValueRange};
use albireo_core::detection::ClassId;

/// Box, score and class.
const ROW: usize = 6;

/// The parameters for reading the output.
#[derive(Debug)]
struct EndToEnd {
    /// -1 if the number depends on the picture.
    boxes: i64,
}

pub(super) fn bind(signature: &Signature, input: PictureInput) -> Result<Head, Misfit> {
    let misfit = misfit(HeadName::EndToEnd);
    let output = signature.only_output().map_err(&misfit)?;
    match *output.shape.as_slice() {
        [1 | -1, boxes, row] if count(row) == ROW && (boxes == -1 || boxes > 0) => {
            let (fit, range) = (Fit::Centre(114), ValueRange::ToOne);
            Ok(Head {
                name: HeadName::EndToEnd,
                classes: None,
                input_format: format(input, fit, ColorOrder::Rgb, range),
                overlaps: false,
                reader: Box::new(EndToEnd { boxes }),
            })
        }
        _ => Err(misfit("its output has another shape".to_owned())),
    }
}

impl ReadOutputs for EndToEnd {
    fn read(
        &self,
        outputs: &[TensorView<'_>],
        confidence: f64,
        candidates: &mut Vec<Candidate>,
    ) -> Result<u64, String> {
        let values = only(outputs, &[1, self.boxes, ROW as i64])?;
        let mut rejected = 0;
        for row in values.chunks_exact(ROW) {
            let (score, class) = (row[4], row[5]);
            // Unused rows are all 0. NaN is not skipped, so that it is counted.
            if is_score(score) && f64::from(score) < confidence {
                continue;
            }
            let corners = corners(row);
            let found = class_number(class).and_then(|class| candidate(corners, class, score));
            match found {
                Some(candidate) => candidates.push(candidate),
                None => rejected += 1,
            }
        }
        Ok(rejected)
    }
}

/// A class number written as a floating-point number.
fn class_number(value: f32) -> Option<ClassId> {
    let whole = value.fract() == 0.0 && (0.0..=f32::from(u16::MAX)).contains(&value);
    whole.then_some(ClassId(value as u16))
}
