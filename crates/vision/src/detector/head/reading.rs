//! Functions that the heads share: finding outputs, checking shapes, making boxes from numbers.

use super::{Candidate, Evidence};
use crate::onnx::{TensorView, shape_text};
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};

/// Strides of the three feature maps of YOLO models.
pub(super) const STRIDES: [u32; 3] = [8, 16, 32];

/// The number of cells of all strides in an input of `size`.
pub(super) fn cells(size: PictureSize, strides: &[u32]) -> usize {
    strides
        .iter()
        .map(|stride| (size.width / stride) as usize * (size.height / stride) as usize)
        .sum()
}

/// The same with the cells that reach beyond the input.
pub(super) fn cells_of_part(size: PictureSize, strides: &[u32]) -> usize {
    strides
        .iter()
        .map(|&stride| size.width.div_ceil(stride) as usize * size.height.div_ceil(stride) as usize)
        .sum()
}

/// True if a dimension of the model, which may be open, can be `wanted`.
pub(super) fn can_be(dimension: i64, wanted: usize) -> bool {
    dimension == -1 || usize::try_from(dimension) == Ok(wanted)
}

/// A dimension as a count; 0 if it is open.
pub(super) fn count(dimension: i64) -> usize {
    usize::try_from(dimension).unwrap_or(0)
}

/// What a head reads from the rows of its outputs.
pub(super) struct Rows<'a> {
    /// The least confidence of a candidate.
    pub(super) confidence: f64,
    pub(super) candidates: &'a mut Vec<Candidate>,
    /// The input: a box of more than [`LARGEST_BOX`] times its side is not possible.
    pub(super) size: PictureSize,
    /// Rows with a number that is not finite or not possible.
    pub(super) rejected: u64,
}

/// The longest possible side of a box, in sides of the input. Objects at the border give boxes that reach beyond it; a box
/// that is much longer has been read wrong.
const LARGEST_BOX: f64 = 4.0;

/// The largest number of a box that is written in sides of the input.
const LARGEST_SIDE: f64 = 2.0;

impl Rows<'_> {
    /// Adds the candidate of a row if it is confident enough. Counts a row without one as rejected, and one whose box is
    /// much larger than the input.
    pub(super) fn add(&mut self, row: Option<Candidate>) {
        let fits = |candidate: &Candidate| {
            let Corners { x1, y1, x2, y2 } = candidate.corners;
            x2 - x1 <= LARGEST_BOX * f64::from(self.size.width)
                && y2 - y1 <= LARGEST_BOX * f64::from(self.size.height)
        };
        let Some(candidate) = row.filter(fits) else {
            self.rejected += 1;
            return;
        };
        if f64::from(candidate.confidence) >= self.confidence {
            self.candidates.push(candidate);
        }
    }
}

/// The elements of the only output, which must have this shape; -1 matches any dimension.
pub(super) fn only<'a>(outputs: &[TensorView<'a>], expected: &[i64]) -> Result<&'a [f32], String> {
    match outputs {
        [output] => elements(output, expected),
        _ => Err(format!(
            "the model returned {} outputs instead of one",
            outputs.len()
        )),
    }
}

/// The elements of `output`, which must have this shape; -1 matches any dimension.
pub(super) fn elements<'a>(output: &TensorView<'a>, expected: &[i64]) -> Result<&'a [f32], String> {
    let is_as_expected =
        |(&actual, &expected): (&i64, &i64)| actual >= 0 && (expected == -1 || actual == expected);
    let fits = output.shape.len() == expected.len()
        && output.shape.iter().zip(expected).all(is_as_expected);
    if !fits || elements_of(output.shape) != Some(output.values.len()) {
        return Err(format!(
            "the model returned an output of {} instead of {}",
            shape_text(output.shape),
            shape_text(expected)
        ));
    }
    Ok(output.values)
}

/// The number of elements of a tensor with this shape; `None` if it is not representable.
fn elements_of(shape: &[i64]) -> Option<usize> {
    let mut elements = 1_usize;
    for &side in shape {
        let side = usize::try_from(side).ok()?;
        elements = elements.checked_mul(side)?;
    }
    Some(elements)
}

/// True if `score` is a number from 0 to 1, within rounding (of float16 too).
pub(super) fn is_score(score: f32) -> bool {
    (-1e-3..=1.001).contains(&score)
}

/// The class with the largest score, and that score; `None` if one of the numbers is not a score.
pub(super) fn best_class(scores: &[f32]) -> Option<(ClassId, f32)> {
    if scores.is_empty() {
        return None;
    }
    let mut best = 0;
    let mut highest = f32::NEG_INFINITY;
    for (class, &score) in scores.iter().enumerate() {
        if !is_score(score) {
            return None;
        }
        if score > highest {
            best = class;
            highest = score;
        }
    }
    let class = u16::try_from(best).ok()?;
    Some((ClassId(class), highest.clamp(0.0, 1.0)))
}

/// The unit of a model's boxes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Unit {
    /// Pixels of the input.
    Pixels,
    /// Sides of the input, which has this size: from 0 to 1.
    Sides(PictureSize),
}

impl Unit {
    /// The corners in pixels of the input.
    pub(super) fn pixels(self, corners: Corners) -> Corners {
        let Self::Sides(size) = self else {
            return corners;
        };
        let width = f64::from(size.width);
        let height = f64::from(size.height);
        Corners {
            x1: corners.x1 * width,
            y1: corners.y1 * height,
            x2: corners.x2 * width,
            y2: corners.y2 * height,
        }
    }
}

/// The unit of the boxes of one run: that of most of them. A box in pixels is hardly ever all within the first two pixels,
/// and one in sides of the input hardly ever reaches far beyond it.
pub(super) fn unit(boxes: impl Iterator<Item = [f64; 4]>, size: PictureSize) -> Unit {
    let mut in_pixels = 0_usize;
    let mut in_sides = 0_usize;
    for largest in boxes.filter_map(largest_number) {
        if largest > LARGEST_SIDE {
            in_pixels += 1;
        } else {
            in_sides += 1;
        }
    }
    if in_pixels > in_sides {
        Unit::Pixels
    } else {
        Unit::Sides(size)
    }
}

/// The largest number of a box, without its sign; `None` if it does not tell how boxes are written: all are 0, as in an
/// unused row, or one is not finite.
pub(super) fn largest_number(sides: [f64; 4]) -> Option<f64> {
    let mut largest = 0.0_f64;
    for side in sides {
        if !side.is_finite() {
            return None;
        }
        largest = largest.max(side.abs());
    }
    if largest > 0.0 { Some(largest) } else { None }
}

/// What tells against boxes that are read as centre and sides if they [are corners](are_corners).
pub(super) fn corners_not_centres() -> Evidence {
    Evidence::against_with(
        "each of its boxes is written as two corners, and not as centre and sides, as in YOLO26 and YOLOv10 before they \
         select the best",
        "Export it with that selection",
    )
}

/// True if the boxes of a whole grid are two corners: the third and fourth numbers of nearly all are beyond the first and
/// second, and grow with them. Sides can be longer than the distance of their centre, but are not the longer the farther
/// right or down it is.
pub(super) fn are_corners(
    boxes: impl Iterator<Item = [f64; 4]>,
    unit: Unit,
    size: PictureSize,
) -> bool {
    let mut total = 0_usize;
    let mut in_order = 0_usize;
    let mut across = SecondEnds::new(f64::from(size.width));
    let mut down = SecondEnds::new(f64::from(size.height));
    for sides in boxes {
        if largest_number(sides).is_some() {
            let [x1, y1, x2, y2] = sides;
            let Corners { x1, y1, x2, y2 } = unit.pixels(Corners { x1, y1, x2, y2 });
            total += 1;
            in_order += usize::from(x1 < x2 && y1 < y2);
            across.add(x1, x2);
            down.add(y1, y2);
        }
    }
    10 * in_order > 9 * total && across.grow() && down.grow()
}

/// The second of two numbers per box, by where the first lies in a length.
struct SecondEnds {
    length: f64,
    /// Those of the first third.
    early: Mean,
    /// Those of the last.
    late: Mean,
}

impl SecondEnds {
    fn new(length: f64) -> Self {
        Self {
            length,
            early: Mean::default(),
            late: Mean::default(),
        }
    }

    fn add(&mut self, first: f64, second: f64) {
        if first < self.length / 3.0 {
            self.early.add(second);
        } else if first > self.length * 2.0 / 3.0 {
            self.late.add(second);
        }
    }

    /// True if they grow with the first, from the first third to the last, by at least a third of the length.
    fn grow(&self) -> bool {
        // Without a number the mean is none, and nothing has grown.
        self.late.value() - self.early.value() > self.length / 3.0
    }
}

/// A mean as it grows.
#[derive(Default)]
struct Mean {
    sum: f64,
    count: u32,
}

impl Mean {
    fn add(&mut self, number: f64) {
        self.sum += number;
        self.count += 1;
    }

    /// No number if none was added.
    fn value(&self) -> f64 {
        self.sum / f64::from(self.count)
    }
}

/// The corners of a box, given its centre x, centre y, width and height.
pub(super) fn around([center_x, center_y, width, height]: [f64; 4]) -> Corners {
    Corners {
        x1: center_x - width / 2.0,
        y1: center_y - height / 2.0,
        x2: center_x + width / 2.0,
        y2: center_y + height / 2.0,
    }
}

/// The candidate, if its corners are finite and enclose an area and its confidence is a score.
pub(super) fn candidate(corners: Corners, class: ClassId, confidence: f32) -> Option<Candidate> {
    let Corners { x1, y1, x2, y2 } = corners;
    let possible = [x1, y1, x2, y2].iter().all(|value| value.is_finite())
        && x2 > x1
        && y2 > y1
        && is_score(confidence);
    if !possible {
        return None;
    }
    Some(Candidate {
        corners,
        class,
        confidence: confidence.clamp(0.0, 1.0),
    })
}
