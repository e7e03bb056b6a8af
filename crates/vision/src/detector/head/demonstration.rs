//! The head of the demonstration detector of `models/`: one output `[1, cells, 4 + classes]`, each row the
//! corners x1, y1, x2, y2 in input pixels and then one score a class, 0 to 1. Overlaps are ours to suppress.

use super::reading::{best_class, candidate, corners, count, format, misfit, only};
use super::{Candidate, Head, Misfit, ReadOutputs, TensorView};
use crate::detector::{HeadName, PictureInput, Signature};
use crate::picture::{ColorOrder, Fit, ValueRange};

/// The box, before the class scores.
const BEFORE_CLASSES: usize = 4;

/// What reading it takes.
#[derive(Debug)]
struct Demonstration {
    cells: i64,
    row: usize,
}

pub(super) fn bind(signature: &Signature, input: PictureInput) -> Result<Head, Misfit> {
    let misfit = misfit(HeadName::Demonstration);
    let output = signature.only_output().map_err(&misfit)?;
    match *output.shape.as_slice() {
        [1 | -1, cells, row] if cells > 0 && count(row) > BEFORE_CLASSES => {
            let row = count(row);
            let (fit, range) = (Fit::TopLeft(114), ValueRange::ToOne);
            Ok(Head {
                name: HeadName::Demonstration,
                classes: Some(row - BEFORE_CLASSES),
                input_format: format(input, fit, ColorOrder::Rgb, range),
                overlaps: true,
                reader: Box::new(Demonstration { cells, row }),
            })
        }
        _ => Err(misfit("its output has another shape".to_owned())),
    }
}

impl ReadOutputs for Demonstration {
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
            let corners = corners(row);
            match candidate(corners, class, score) {
                Some(candidate) => candidates.push(candidate),
                None => rejected += 1,
            }
        }
        Ok(rejected)
    }
}
