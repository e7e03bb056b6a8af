//! The head of YOLOv8, YOLO11 and of YOLO26 in its one-to-many form, as Ultralytics exports them: one output
//! `[1, 4 + classes, anchors]`, decoded. The rows are centre x, centre y, width and height in input pixels, then one
//! score per class; there is no objectness. Overlaps remain to be suppressed.

use super::reading::{Rows, around, candidate, count, is_score, only};
use super::{Bound, ReadOutputs, TensorView};
use crate::detector::Signature;
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

pub(super) fn bind(signature: &Signature) -> Bound {
    match *signature.only_output()?.shape.as_slice() {
        [1 | -1, rows, anchors]
            if count(rows) > BEFORE_CLASSES
                && count(rows) - BEFORE_CLASSES <= usize::from(u16::MAX)
                && (anchors == -1 || anchors > 0) =>
        {
            let classes = count(rows) - BEFORE_CLASSES;
            Ok((Some(classes), Box::new(Yolo { classes, anchors })))
        }
        _ => Err("its output has another shape".to_owned()),
    }
}

impl ReadOutputs for Yolo {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let numbers = BEFORE_CLASSES + self.classes;
        let values = only(outputs, &[1, numbers as i64, self.anchors])?;
        let anchors = values.len() / numbers;
        let row = |number: usize| &values[number * anchors..][..anchors];
        let sides = [row(0), row(1), row(2), row(3)];
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
                if sound[place] && f64::from(score) < rows.confidence {
                    continue;
                }
                let corners = around(sides.map(|row| f64::from(row[start + place])));
                let read = candidate(corners, ClassId(class), score);
                rows.add(read.filter(|_| sound[place]));
            }
        }
        Ok(())
    }
}
