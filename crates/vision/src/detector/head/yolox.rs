//! The head of YOLOX (Ge et al., "YOLOX: Exceeding YOLO Series in 2021"): one output `[1, cells, 5 + classes]`, not
//! decoded: the cells of strides 8, 16 and 32 in sequence, each row by row.

use super::reading::{Rows, STRIDES, around, best_class, can_be, candidate, cells, count, only};
use super::{Bound, Candidate, ReadOutputs, TensorView};
use crate::detector::Signature;
use albireo_core::geometry::PictureSize;

/// Box and objectness, before the class scores.
const BEFORE_CLASSES: usize = 5;

/// The parameters for reading the output.
#[derive(Debug)]
struct Yolox {
    size: PictureSize,
    row: usize,
}

pub(super) fn bind(signature: &Signature, size: PictureSize) -> Bound {
    if !size.width.is_multiple_of(32) || !size.height.is_multiple_of(32) {
        return Err(format!(
            "its input of {size} has a side that is not a multiple of 32"
        ));
    }
    let cells = cells(size, &STRIDES);
    match *signature.only_output()?.shape.as_slice() {
        [1 | -1, rows, row] if can_be(rows, cells) && count(row) > BEFORE_CLASSES => {
            let row = count(row);
            Ok((Some(row - BEFORE_CLASSES), Box::new(Yolox { size, row })))
        }
        _ => Err(format!(
            "its output has another shape than [1, {cells}, 5 + classes]"
        )),
    }
}

impl ReadOutputs for Yolox {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let size = self.size;
        let cells = cells(size, &STRIDES) as i64;
        let values = only(outputs, &[1, cells, self.row as i64])?;
        let mut cells = values.chunks_exact(self.row);
        for stride in STRIDES {
            let columns = size.width / stride;
            for cell in 0..columns * (size.height / stride) {
                let Some(row) = cells.next() else { break };
                // Class scores are at most 1, so most cells end here. NaN is not skipped, so that it is counted.
                if f64::from(row[4]) < rows.confidence {
                    continue;
                }
                rows.add(decode(row, cell % columns, cell / columns, stride));
            }
        }
        Ok(())
    }
}

/// The candidate of one cell; `None` if its numbers are not possible.
fn decode(row: &[f32], column: u32, line: u32, stride: u32) -> Option<Candidate> {
    let (_, objectness) = best_class(&row[4..5])?;
    let (class, score) = best_class(&row[BEFORE_CLASSES..])?;
    let stride = f64::from(stride);
    let corners = around([
        (f64::from(row[0]) + f64::from(column)) * stride,
        (f64::from(row[1]) + f64::from(line)) * stride,
        f64::from(row[2]).exp() * stride,
        f64::from(row[3]).exp() * stride,
    ]);
    candidate(corners, class, objectness * score)
}
