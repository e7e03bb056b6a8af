//! The head of the demonstration detector of `models/`: one output `[1, cells, 4 + classes]`, each row the
//! corners x1, y1, x2, y2 in input pixels and then one score a class, 0 to 1. Overlaps are ours to suppress.

use super::{Candidate, Misfit, best_class, is_possible};
use crate::detector::Signature;
use crate::frame::{ColorOrder, Fit, InputFormat, ValueRange};
use crate::geometry::{Corners, PictureSize};

/// The box, before the class scores.
const BEFORE_CLASSES: usize = 4;

/// The head bound to a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Demonstration {
    input: PictureSize,
    cells: usize,
    classes: usize,
}

impl Demonstration {
    pub(super) fn bind(signature: &Signature, classes: usize) -> Result<Self, Misfit> {
        let misfit = |reason: String| Misfit {
            expected: format!(
                "one float32 input [1, 3, rows, columns] and one float32 output [1, cells, {}] (box and \
                 {classes} classes)",
                BEFORE_CLASSES + classes
            ),
            reason,
        };
        let input = signature.picture_input().map_err(misfit)?;
        let output = signature.only_output().map_err(misfit)?;
        let expected = (BEFORE_CLASSES + classes) as i64;
        match *output.shape.as_slice() {
            [1 | -1, cells, row] if cells > 0 && row == expected => Ok(Self {
                input,
                cells: usize::try_from(cells).map_err(|error| misfit(error.to_string()))?,
                classes,
            }),
            [1 | -1, cells, row] if cells > 0 && row > BEFORE_CLASSES as i64 => {
                Err(misfit(format!(
                    "its output has {row} numbers a cell, which is {} classes where {classes} names are given",
                    row - BEFORE_CLASSES as i64
                )))
            }
            _ => Err(misfit("its output has another shape".to_owned())),
        }
    }

    pub(super) fn input_format(&self) -> InputFormat {
        InputFormat {
            size: self.input,
            fit: Fit::TopLeft(114),
            color_order: ColorOrder::Rgb,
            value_range: ValueRange::ToOne,
        }
    }

    /// Rows of the output.
    pub(super) fn cells(&self) -> usize {
        self.cells
    }

    /// Numbers a row.
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
        for row in values.chunks_exact(self.row()) {
            let Some((class, score)) = best_class(&row[BEFORE_CLASSES..]) else {
                rejected += 1;
                continue;
            };
            if f64::from(score) < confidence {
                continue;
            }
            let corners = Corners {
                x1: f64::from(row[0]),
                y1: f64::from(row[1]),
                x2: f64::from(row[2]),
                y2: f64::from(row[3]),
            };
            if is_possible(corners) {
                candidates.push(Candidate {
                    corners,
                    class,
                    confidence: score,
                });
            } else {
                rejected += 1;
            }
        }
        Ok(rejected)
    }
}
