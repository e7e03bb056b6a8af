//! RT-DETR with one output: a row per query, with a box and a score per class.

use super::dense::Dense;
use super::reading::Rows;
use super::{Evidence, ReadOutputs};
use crate::onnx::TensorView;

/// The parameters for reading the output.
#[derive(Debug)]
pub(super) struct RtDetr(pub(super) Dense);

/// True if rows of six numbers end with a score and a class instead of two scores. No score of every query is a whole
/// number.
fn end_with_class(numbers: &[f32], confidence: f64) -> bool {
    let (rows, _) = numbers.as_chunks::<6>();
    rows.iter().any(|row| f64::from(row[4]) >= confidence)
        && rows.iter().all(|row| row[5].fract() == 0.0)
}

/// The most numbers in a row of final boxes: the box, its score and class, and some points.
const MOST_NUMBERS: usize = 16;

/// True if rows of `length` numbers are final boxes: more than one in ten begins with four whole numbers, as an unused row
/// does, or one of these is whole in every row, as the number of a picture is. The sides of queries are neither.
fn are_final(numbers: &[f32], length: usize) -> bool {
    let rows = numbers.chunks_exact(length);
    let total = rows.len();
    if length > MOST_NUMBERS || total == 0 {
        return false;
    }
    let is_whole = |row: &[f32], place: usize| row[place].fract() == 0.0;
    let is_unused = |row: &&[f32]| (0..4).all(|place| is_whole(row, place));
    let unused = rows.clone().filter(is_unused).count();
    let is_number = |place: usize| rows.clone().all(|row| is_whole(row, place));
    10 * unused > total || (0..4).any(is_number)
}

impl ReadOutputs for RtDetr {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        self.0.read(outputs, rows)
    }

    // Each query is another object.
    fn overlaps_in(&self, _outputs: &[TensorView<'_>]) -> bool {
        false
    }

    fn evidence(&self, outputs: &[TensorView<'_>], confidence: f64) -> Evidence {
        if self.0.classes == 2
            && let Some(output) = outputs.get(self.0.boxes)
            && end_with_class(output.values, confidence)
        {
            return Evidence::Against(
                "its rows end with a class and not with two scores. For RT-DETR of Ultralytics 8.4 set detector.head = \
                 { columns = \"cx cy w h score class\" } and detector.fit = \"stretch\""
                    .to_owned(),
            );
        }
        let length = 4 + self.0.classes;
        if let Some(output) = outputs.get(self.0.boxes)
            && are_final(output.values, length)
        {
            return Evidence::Against(format!(
                "its rows of {length} numbers are final boxes and no queries: many begin with four whole numbers, as unused \
                 rows do, or all have a whole number in one of these places. List their columns, `_` for what is none of \
                 them, for example detector.head = {{ columns = \"batch class score x1 y1 x2 y2\" }}"
            ));
        }
        self.0.evidence(outputs, confidence)
    }
}
