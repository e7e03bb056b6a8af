//! The head of FastestDet (dog-qiuqiu, 2022): one output `[1, 5 + classes, rows, columns]` with one cell per 16x16
//! pixels; the channels are objectness, four numbers of the box, and class scores. Overlaps remain to be suppressed.

use super::reading::{Rows, around, best_class, candidate, count, is_score, only};
use super::{Bound, ReadOutputs};
use crate::onnx::{Signature, TensorView};
use albireo_core::geometry::PictureSize;

/// Objectness and box, before the class scores.
const BEFORE_CLASSES: usize = 5;
const STRIDE: u32 = 16;

/// The parameters for reading the output.
#[derive(Debug)]
struct FastestDet {
    size: PictureSize,
    classes: usize,
}

pub(super) fn bind(signature: &Signature, size: PictureSize) -> Result<Bound, String> {
    let columns = i64::from(size.width / STRIDE);
    let lines = i64::from(size.height / STRIDE);
    let other_shape =
        || format!("its output has another shape than [1, 5 + classes, {lines}, {columns}]");
    let [1 | -1, channels, height, width] = *signature.only_output()?.shape.as_slice() else {
        return Err(other_shape());
    };
    let classes = count(channels).saturating_sub(BEFORE_CLASSES);
    let have_classes = (1..=usize::from(u16::MAX)).contains(&classes);
    let are_cells = height == lines && width == columns && lines * columns > 0;
    if !have_classes || !are_cells {
        return Err(other_shape());
    }
    Ok(Bound {
        classes: Some(classes),
        reader: Box::new(FastestDet { size, classes }),
    })
}

impl ReadOutputs for FastestDet {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let size = self.size;
        let [columns, lines] = [size.width, size.height].map(|side| (side / STRIDE) as usize);
        let channels = BEFORE_CLASSES + self.classes;
        let values = only(outputs, &[1, channels as i64, lines as i64, columns as i64])?;
        let cells = lines * columns;
        let channel = |number: usize, cell: usize| values[number * cells + cell];
        let mut scores = Vec::with_capacity(self.classes);
        for cell in 0..cells {
            let objectness = channel(0, cell);
            // The score is at most objectness^0.6. NaN is not skipped, so that it is counted.
            if is_score(objectness) && f64::from(objectness.max(0.0)).powf(0.6) < rows.confidence {
                continue;
            }
            scores.clear();
            scores.extend((0..self.classes).map(|class| channel(BEFORE_CLASSES + class, cell)));
            match best_class(&scores) {
                Some((class, score)) if is_score(objectness) => {
                    let x = f64::from(channel(1, cell));
                    let y = f64::from(channel(2, cell));
                    let width = f64::from(channel(3, cell));
                    let height = f64::from(channel(4, cell));
                    let column = (cell % columns) as f64;
                    let line = (cell / columns) as f64;
                    let corners = around([
                        (x.tanh() + column) / columns as f64 * f64::from(size.width),
                        (y.tanh() + line) / lines as f64 * f64::from(size.height),
                        sigmoid(width) * f64::from(size.width),
                        sigmoid(height) * f64::from(size.height),
                    ]);
                    let score = objectness.max(0.0).powf(0.6) * score.powf(0.4);
                    rows.add(candidate(corners, class, score));
                }
                _ => rows.add(None),
            }
        }
        Ok(())
    }
}

fn sigmoid(value: f64) -> f64 {
    1.0 / (1.0 + (-value).exp())
}
