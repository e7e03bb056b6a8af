//! The head of YOLOX (Ge et al., "YOLOX: Exceeding YOLO Series in 2021"): one output `[1, cells, 5 + classes]`, not
//! decoded: the cells of strides 8, 16 and 32 in sequence, each row by row.

use super::reading::{
    STRIDES, around, best_class, can_be, candidate, cells, count, format, misfit, only,
};
use super::{Candidate, Head, Misfit, ReadOutputs, TensorView};
use crate::detector::{HeadName, PictureInput, Signature};
use crate::picture::{ColorOrder, Fit, ValueRange};
use albireo_core::geometry::PictureSize;

/// Box and objectness, before the class scores.
const BEFORE_CLASSES: usize = 5;

/// The parameters for reading the output.
#[derive(Debug)]
struct Yolox {
    size: PictureSize,
    row: usize,
}

pub(super) fn bind(signature: &Signature, input: PictureInput) -> Result<Head, Misfit> {
    let misfit = misfit(HeadName::Yolox);
    let size = input.size;
    if !size.width.is_multiple_of(32) || !size.height.is_multiple_of(32) {
        let reason = format!("its input of {size} has a side that is not a multiple of 32");
        return Err(misfit(reason));
    }
    let cells = cells(size, &STRIDES);
    let output = signature.only_output().map_err(&misfit)?;
    match *output.shape.as_slice() {
        [1 | -1, rows, row] if can_be(rows, cells) && count(row) > BEFORE_CLASSES => {
            let row = count(row);
            let (fit, range) = (Fit::TopLeft(114), ValueRange::To255);
            Ok(Head {
                name: HeadName::Yolox,
                classes: Some(row - BEFORE_CLASSES),
                input_format: format(input, fit, ColorOrder::Bgr, range),
                overlaps: true,
                reader: Box::new(Yolox { size, row }),
            })
        }
        _ => Err(misfit(format!(
            "its output has another shape than [1, {cells}, 5 + classes]"
        ))),
    }
}

impl ReadOutputs for Yolox {
    fn read(
        &self,
        outputs: &[TensorView<'_>],
        confidence: f64,
        candidates: &mut Vec<Candidate>,
    ) -> Result<u64, String> {
        let size = self.size;
        let cells = cells(size, &STRIDES) as i64;
        let values = only(outputs, &[1, cells, self.row as i64])?;
        let mut rejected = 0;
        let mut rows = values.chunks_exact(self.row);
        for stride in STRIDES {
            let columns = size.width / stride;
            for cell in 0..columns * (size.height / stride) {
                let Some(row) = rows.next() else { break };
                // Class scores are at most 1, so most cells end here. NaN is not skipped, so that it is counted.
                if f64::from(row[4]) < confidence {
                    continue;
                }
                match decode(row, cell % columns, cell / columns, stride) {
                    Some(candidate) if f64::from(candidate.confidence) >= confidence => {
                        candidates.push(candidate);
                    }
                    Some(_) => {}
                    None => rejected += 1,
                }
            }
        }
        Ok(rejected)
    }
}

/// The candidate of one cell; `None` if its numbers are not possible.
fn decode(row: &[f32], column: u32, line: u32, stride: u32) -> Option<Candidate> {
    let (_, objectness) = best_class(&row[4..5])?;
    let (class, score) = best_class(&row[BEFORE_CLASSES..])?;
    let stride = f64::from(stride);
    let corners = around(
        (f64::from(row[0]) + f64::from(column)) * stride,
        (f64::from(row[1]) + f64::from(line)) * stride,
        f64::from(row[2]).exp() * stride,
        f64::from(row[3]).exp() * stride,
    );
    candidate(corners, class, objectness * score)
}
