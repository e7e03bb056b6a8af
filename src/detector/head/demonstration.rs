//! The head of the demonstration detector of `models/`: one output `[1, cells, 4 + classes]`, each row the
//! corners x1, y1, x2, y2 in input pixels and then one score a class, 0 to 1. Overlaps are ours to suppress.

use super::reading::{best_class, candidate, count, format, misfit, only};
use super::{Candidate, Head, Misfit, TensorView};
use crate::detector::{HeadName, PictureInput, Signature};
use crate::frame::{ColorOrder, Fit, InputFormat, ValueRange};
use crate::geometry::Corners;

/// The box, before the class scores.
const BEFORE_CLASSES: usize = 4;

/// The head bound to a model.
#[derive(Clone, Debug)]
pub(super) struct Demonstration {
    input: PictureInput,
    cells: i64,
    row: usize,
}

impl Demonstration {
    pub(super) fn bind(signature: &Signature, input: PictureInput) -> Result<Self, Misfit> {
        let misfit = misfit(HeadName::Demonstration);
        let output = signature.only_output().map_err(&misfit)?;
        match *output.shape.as_slice() {
            [1 | -1, cells, row] if cells > 0 && count(row) > BEFORE_CLASSES => Ok(Self {
                input,
                cells,
                row: count(row),
            }),
            _ => Err(misfit("its output has another shape".to_owned())),
        }
    }
}

impl Head for Demonstration {
    fn name(&self) -> HeadName {
        HeadName::Demonstration
    }

    fn classes(&self) -> Option<usize> {
        Some(self.row - BEFORE_CLASSES)
    }

    fn input_format(&self) -> InputFormat {
        format(
            self.input,
            Fit::TopLeft(114),
            ColorOrder::Rgb,
            ValueRange::ToOne,
        )
    }

    fn read(
        &self,
        outputs: &[TensorView<'_>],
        confidence: f64,
        candidates: &mut Vec<Candidate>,
    ) -> Result<u64, String> {
        let values = only(outputs, &[1, self.cells, self.row as i64])?;
        let mut rejected = 0;
        for row in values.chunks_exact(self.row) {
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
            match candidate(corners, class, score) {
                Some(candidate) => candidates.push(candidate),
                None => rejected += 1,
            }
        }
        Ok(rejected)
    }
}
