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
pub(super) const MOST_NUMBERS: usize = 16;

/// True if rows of `length` numbers are final boxes: more than one in ten begins with four whole numbers, as an unused row
/// does, or one of these is a whole number in every row, as the number of a picture or a class is. The sides of queries are
/// neither, but a side may be 0 or 1 everywhere. Rows of zeros, which a black picture may give, say nothing.
fn are_final(numbers: &[f32], length: usize) -> bool {
    if length > MOST_NUMBERS {
        return false;
    }
    let mut total = 0_usize;
    let mut unused = 0_usize;
    let mut first_is_0 = true;
    let mut places = [NumbersAtPlace::default(); 4];
    for row in numbers.chunks_exact(length) {
        if row.iter().all(|&number| number == 0.0) {
            continue;
        }
        total += 1;
        unused += usize::from(row.iter().take(4).all(|number| number.fract() == 0.0));
        first_is_0 &= row[0] == 0.0;
        for (place, &number) in places.iter_mut().zip(row) {
            place.has_part |= number.fract() != 0.0;
            place.is_beyond_sides |= number != 0.0 && number != 1.0;
        }
    }
    let is_number = |place: &NumbersAtPlace| !place.has_part && place.is_beyond_sides;
    total > 0 && (10 * unused > total || first_is_0 || places.iter().any(is_number))
}

/// What the numbers in one place of all rows are.
#[derive(Clone, Copy, Default)]
struct NumbersAtPlace {
    /// True if one of them is no whole number.
    has_part: bool,
    /// True if one of them is neither 0 nor 1, the ends of the input.
    is_beyond_sides: bool,
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
            return Evidence::against_with(
                "its rows end with a class and not with two scores",
                "For RT-DETR of Ultralytics 8.4 set detector.head = { columns = \"cx cy w h score class\" } and detector.fit \
                 = \"stretch\"",
            );
        }
        let length = 4 + self.0.classes;
        if let Some(output) = outputs.get(self.0.boxes)
            && are_final(output.values, length)
        {
            return Evidence::against_with(
                format!(
                    "its rows of {length} numbers are final boxes and no queries: many begin with four whole numbers, as \
                     unused rows do, or all have a whole number in one of these places"
                ),
                "List their columns, `_` for what is none of them, for example detector.head = { columns = \"batch class \
                 score x1 y1 x2 y2\" }",
            );
        }
        self.0.evidence(outputs, confidence)
    }
}
