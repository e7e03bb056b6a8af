//! The head of models that output final boxes (YOLO26, YOLOv10, and exports with suppression inside): one output
//! `[1, boxes, 6]`, each row x1, y1, x2, y2 in input pixels, score, class. Nothing is left to suppress.

use super::reading::{Rows, candidate, count, is_score, only};
use super::{Bound, ReadOutputs, TensorView};
use crate::detector::Signature;
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;

/// Box, score and class.
const ROW: usize = 6;

/// The parameters for reading the output.
#[derive(Debug)]
struct EndToEnd {
    /// -1 if the number depends on the picture.
    boxes: i64,
}

pub(super) fn bind(signature: &Signature) -> Bound {
    match *signature.only_output()?.shape.as_slice() {
        [1 | -1, boxes, row] if count(row) == ROW && (boxes == -1 || boxes > 0) => {
            Ok((None, Box::new(EndToEnd { boxes })))
        }
        _ => Err("its output has another shape".to_owned()),
    }
}

impl ReadOutputs for EndToEnd {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let values = only(outputs, &[1, self.boxes, ROW as i64])?;
        let (values, _) = values.as_chunks::<ROW>();
        for &[x1, y1, x2, y2, score, class] in values {
            // Unused rows are all 0. NaN is not skipped, so that it is counted.
            if is_score(score) && f64::from(score) < rows.confidence {
                continue;
            }
            let [x1, y1, x2, y2] = [x1, y1, x2, y2].map(f64::from);
            let corners = Corners { x1, y1, x2, y2 };
            rows.add(class_number(class).and_then(|class| candidate(corners, class, score)));
        }
        Ok(())
    }
}

/// A class number written as a floating-point number.
fn class_number(value: f32) -> Option<ClassId> {
    let whole = value.fract() == 0.0 && (0.0..=f32::from(u16::MAX)).contains(&value);
    whole.then_some(ClassId(value as u16))
}
