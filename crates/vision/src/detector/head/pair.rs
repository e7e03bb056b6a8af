//! Models with boxes and scores in two outputs, `[1, cells, 4]` and `[1, cells, classes]`: YOLO-NAS, and others with
//! the same outputs, which are refused where they can be told.

use super::dense::{BoxForm, Dense, rows_with_classes};
use super::families::is_cells;
use super::reading::{Rows, is_score};
use super::{Bound, Evidence, ReadOutputs};
use crate::onnx::{Signature, TensorSpec, TensorView};
use albireo_core::geometry::PictureSize;

/// How the outputs are read, unless both have four numbers in a row: then a run tells which has the boxes.
#[derive(Debug)]
struct BoxesAndScores(Dense);

/// Binds the two outputs of a model.
pub(super) fn bind(
    first: &TensorSpec,
    second: &TensorSpec,
    size: PictureSize,
) -> Result<Bound, String> {
    let boxes = if has_four(first) {
        0
    } else if has_four(second) {
        1
    } else {
        return Err("none of its outputs is [1, cells, 4]".to_owned());
    };
    let [of_boxes, of_scores] = if boxes == 0 {
        [first, second]
    } else {
        [second, first]
    };
    of_boxes.float()?;
    let (anchors, classes) = rows_with_classes(&of_scores.float()?.shape, 0)?;
    let is_row_per_cell = anchors == -1 || is_cells(anchors, size);
    if of_boxes.shape.get(1) != Some(&anchors) || !is_row_per_cell {
        return Err("its outputs do not have a row for each cell".to_owned());
    }
    let reading = Dense {
        size,
        form: BoxForm::Corners,
        anchors,
        classes,
        has_objectness: false,
        boxes,
        scores: Some(1 - boxes),
    };
    Ok(Bound {
        classes: Some(classes),
        reader: Box::new(BoxesAndScores(reading)),
    })
}

/// True if the rows of an output have four numbers.
fn has_four(output: &TensorSpec) -> bool {
    matches!(output.shape.as_slice(), [1 | -1, _, 4])
}

/// True if the outputs have the order and the name that DAMO-YOLO's exporter gives them: the scores first, as `output`.
pub(super) fn is_of_damo_yolo(signature: &Signature) -> bool {
    match signature.outputs.as_slice() {
        [first, second] => first.name == "output" && has_four(second),
        _ => false,
    }
}

/// True if nearly every row of `numbers` is divided among its classes, as by softmax: one of them then stands for "no
/// object".
pub(super) fn are_shares(numbers: &[f32], classes: usize) -> bool {
    if classes < 2 {
        return false;
    }
    let rows = numbers.chunks_exact(classes);
    let total = rows.len();
    let is_divided = |row: &&[f32]| {
        let sum: f32 = row.iter().sum();
        (sum - 1.0).abs() < 0.01 && row.iter().all(|&number| is_score(number))
    };
    let divided = rows.filter(is_divided).count();
    divided > 0 && 10 * divided >= 9 * total
}

impl BoxesAndScores {
    /// How the outputs of this run are read: most numbers of boxes in pixels are larger than any score. One odd score decides
    /// nothing.
    fn of_run(&self, outputs: &[TensorView<'_>]) -> Dense {
        let Self(reading) = *self;
        // As each row of the scores has four numbers, too, either output may have the boxes.
        let may_be_either = reading.classes == 4;
        if may_be_either && beyond_scores(outputs, 1) > beyond_scores(outputs, 0) {
            Dense {
                boxes: 1,
                scores: Some(0),
                ..reading
            }
        } else {
            reading
        }
    }
}

/// How many numbers in this output are larger than any score.
fn beyond_scores(outputs: &[TensorView<'_>], place: usize) -> usize {
    let Some(output) = outputs.get(place) else {
        return 0;
    };
    let is_beyond = |number: &&f32| **number > 0.0 && number.is_finite() && !is_score(**number);
    output.values.iter().filter(is_beyond).count()
}

impl ReadOutputs for BoxesAndScores {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        self.of_run(outputs).read(outputs, rows)
    }

    fn evidence(&self, outputs: &[TensorView<'_>], confidence: f64) -> Evidence {
        let reading = self.of_run(outputs);
        let scores = reading.scores.and_then(|place| outputs.get(place));
        if scores.is_some_and(|scores| are_shares(scores.values, reading.classes)) {
            return Evidence::against_with(
                "the scores of each box sum to 1: one of its classes is the background, as in SSD",
                "Export it with its suppression, as final boxes",
            );
        }
        reading.evidence(outputs, confidence)
    }
}
