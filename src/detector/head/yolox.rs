//! The head of YOLOX (Ge et al., "YOLOX: Exceeding YOLO Series in 2021"): one output `[1, cells, 5 + classes]`,
//! not decoded, cells of the strides 8, 16 and 32 one after the other, each row by row.

use super::{Candidate, Misfit, best_class, is_possible};
use crate::detector::Signature;
use crate::frame::{ColorOrder, Fit, InputFormat, ValueRange};
use crate::geometry::{Corners, PictureSize};

const STRIDES: [u32; 3] = [8, 16, 32];
/// Box and objectness, before the class scores.
const BEFORE_CLASSES: usize = 5;

/// The head bound to a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Yolox {
    input: PictureSize,
    classes: usize,
}

impl Yolox {
    pub(super) fn bind(signature: &Signature, classes: usize) -> Result<Self, Misfit> {
        let misfit = |cells: &str, reason: String| Misfit {
            expected: format!(
                "one float32 input [1, 3, rows, columns] with sides that are multiples of 32, and one float32 \
                 output [1, {cells}, {}] (box, objectness and {classes} classes)",
                BEFORE_CLASSES + classes
            ),
            reason,
        };
        let any = "cells of strides 8, 16 and 32";
        let input = signature
            .picture_input()
            .map_err(|reason| misfit(any, reason))?;
        if input.width % 32 != 0 || input.height % 32 != 0 {
            return Err(misfit(
                any,
                format!("its input of {input} has a side that is no multiple of 32"),
            ));
        }
        let head = Self { input, classes };
        let cells = head.cells().to_string();
        let output = signature
            .only_output()
            .map_err(|reason| misfit(&cells, reason))?;
        match *output.shape.as_slice() {
            [1 | -1, rows, row] if rows == head.cells() as i64 => {
                if row == head.row() as i64 {
                    Ok(head)
                } else {
                    Err(misfit(
                        &cells,
                        format!(
                            "its output has {row} numbers a cell, which is {} classes where {classes} names \
                             are given",
                            row - BEFORE_CLASSES as i64
                        ),
                    ))
                }
            }
            _ => Err(misfit(&cells, "its output has another shape".to_owned())),
        }
    }

    pub(super) fn input_format(&self) -> InputFormat {
        InputFormat {
            size: self.input,
            fit: Fit::TopLeft(114),
            color_order: ColorOrder::Bgr,
            value_range: ValueRange::To255,
        }
    }

    /// Cells of all strides.
    pub(super) fn cells(&self) -> usize {
        STRIDES
            .iter()
            .map(|stride| ((self.input.width / stride) * (self.input.height / stride)) as usize)
            .sum()
    }

    /// Numbers a cell.
    pub(super) fn row(&self) -> usize {
        BEFORE_CLASSES + self.classes
    }

    pub(super) fn read(
        &self,
        values: &[f32],
        confidence: f64,
        candidates: &mut Vec<Candidate>,
    ) -> Result<u64, String> {
        let mut rejected = 0;
        let mut rows = values.chunks_exact(self.row());
        for stride in STRIDES {
            let columns = self.input.width / stride;
            for cell in 0..columns * (self.input.height / stride) {
                let Some(row) = rows.next() else { break };
                let objectness = row[4];
                // Class scores are at most 1, so most cells end here. NaN goes on, to be counted.
                if f64::from(objectness) < confidence {
                    continue;
                }
                let (column, line) = (cell % columns, cell / columns);
                match decode(row, column, line, stride) {
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

/// The candidate of one cell; `None` when its numbers are not possible.
fn decode(row: &[f32], column: u32, line: u32, stride: u32) -> Option<Candidate> {
    let (_, objectness) = best_class(&row[4..5])?;
    let (class, score) = best_class(&row[BEFORE_CLASSES..])?;
    let stride = f64::from(stride);
    let center_x = (f64::from(row[0]) + f64::from(column)) * stride;
    let center_y = (f64::from(row[1]) + f64::from(line)) * stride;
    let width = f64::from(row[2]).exp() * stride;
    let height = f64::from(row[3]).exp() * stride;
    let corners = Corners {
        x1: center_x - width / 2.0,
        y1: center_y - height / 2.0,
        x2: center_x + width / 2.0,
        y2: center_y + height / 2.0,
    };
    is_possible(corners).then_some(Candidate {
        corners,
        class,
        confidence: objectness * score,
    })
}
