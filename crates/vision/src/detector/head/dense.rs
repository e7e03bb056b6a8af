//! The head of models with a row per anchor: a box, perhaps an objectness, and a score per class, side by side. Most
//! families differ only in where these are and in how the box is written. What their shapes do not tell, the values of
//! each run do: sides in pixels or as parts of the input; scores as probabilities or as logits.

use super::reading::{
    Rows, Unit, are_corners, around, best_class, candidate, cells, corners_not_centres, count,
    elements, is_score, unit,
};
use super::{Evidence, ReadOutputs};
use crate::onnx::{TensorView, shape_text};
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};

/// The way in which four numbers are a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BoxForm {
    /// Centre x, centre y, width, height.
    Centre,
    /// The same, as parts of the input's sides.
    CentreInSides,
    /// Left, upper, right, lower.
    Corners,
    /// Not decoded: offsets of the centre in cells, and logarithms of sides. The cells are those of these strides in
    /// sequence, each row by row.
    InCells(&'static [u32]),
}

/// The parameters for reading the outputs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dense {
    /// The input.
    pub(super) size: PictureSize,
    pub(super) form: BoxForm,
    /// -1 if the model leaves the number open.
    pub(super) anchors: i64,
    pub(super) classes: usize,
    pub(super) has_objectness: bool,
    /// The index of the output with the boxes; their rows also hold the scores unless these have an output of their own.
    pub(super) boxes: usize,
    /// The index of the output with a row of scores per anchor, if it is another.
    pub(super) scores: Option<usize>,
}

/// The values of one run, by anchor.
pub(super) struct Anchors<'a> {
    boxes: &'a [f32],
    box_row: usize,
    scores: &'a [f32],
    score_row: usize,
    /// The place of the first class in a row of scores.
    first_class: usize,
    has_objectness: bool,
}

impl<'a> Anchors<'a> {
    fn rows(&self) -> impl Iterator<Item = Anchor<'a>> {
        let first_class = self.first_class;
        let has_objectness = self.has_objectness;
        let boxes = self.boxes.chunks_exact(self.box_row);
        let scores = self.scores.chunks_exact(self.score_row);
        boxes.zip(scores).map(move |(row, scores)| Anchor {
            sides: [row[0], row[1], row[2], row[3]],
            objectness: if has_objectness { Some(row[4]) } else { None },
            scores: &scores[first_class..],
        })
    }

    pub(super) fn sides(&self) -> impl Iterator<Item = [f64; 4]> {
        self.rows().map(|anchor| anchor.sides.map(f64::from))
    }
}

/// The numbers of one anchor.
struct Anchor<'a> {
    /// The box, in the form that the model writes it.
    sides: [f32; 4],
    /// The objectness, if the model has it.
    objectness: Option<f32>,
    /// One score per class.
    scores: &'a [f32],
}

/// The way in which the boxes of one run are written.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Writing {
    Unit(Unit),
    Cells(&'static [u32]),
}

impl Dense {
    pub(super) fn anchors<'a>(&self, outputs: &[TensorView<'a>]) -> Result<Anchors<'a>, String> {
        let missing = || format!("the model returned {} outputs", outputs.len());
        let boxes = outputs.get(self.boxes).ok_or_else(missing)?;
        // Before the scores come four sides and perhaps the objectness.
        let before = if self.has_objectness { 5 } else { 4 };
        match self.scores {
            None => {
                let row = before + self.classes;
                let values = elements(boxes, &[1, self.anchors, row as i64])?;
                Ok(Anchors {
                    boxes: values,
                    box_row: row,
                    scores: values,
                    score_row: row,
                    first_class: before,
                    has_objectness: self.has_objectness,
                })
            }
            Some(scores) => {
                let scores = outputs.get(scores).ok_or_else(missing)?;
                let sides = elements(boxes, &[1, self.anchors, before as i64])?;
                let anchors = (sides.len() / before) as i64;
                Ok(Anchors {
                    boxes: sides,
                    box_row: before,
                    scores: elements(scores, &[1, anchors, self.classes as i64])?,
                    score_row: self.classes,
                    first_class: 0,
                    has_objectness: self.has_objectness,
                })
            }
        }
    }

    /// How the boxes of this run are written: as most of them are. One odd number decides nothing alone: it is as likely to
    /// be a fault.
    fn writing(&self, anchors: &Anchors<'_>) -> Writing {
        match self.form {
            BoxForm::InCells(strides) => Writing::Cells(strides),
            // Pixels are then impossible boxes, and not taken for others.
            BoxForm::CentreInSides => Writing::Unit(Unit::Sides(self.size)),
            BoxForm::Centre | BoxForm::Corners => Writing::Unit(unit(anchors.sides(), self.size)),
        }
    }

    /// The corners of anchor number `anchor`, in pixels of the input.
    fn corners(&self, sides: [f32; 4], writing: Writing, anchor: usize) -> Corners {
        let sides = sides.map(f64::from);
        match writing {
            Writing::Unit(unit) if self.form == BoxForm::Corners => {
                let [x1, y1, x2, y2] = sides;
                unit.pixels(Corners { x1, y1, x2, y2 })
            }
            Writing::Unit(unit) => unit.pixels(around(sides)),
            Writing::Cells(strides) => in_cell(sides, strides, self.size, anchor),
        }
    }
}

/// The cell of an anchor.
pub(super) struct AnchorCell {
    pub(super) column: f64,
    pub(super) line: f64,
    pub(super) stride: f64,
}

/// The cell of anchor number `anchor`; `None` if there are fewer cells.
pub(super) fn cell_of(anchor: usize, strides: &[u32], size: PictureSize) -> Option<AnchorCell> {
    let mut first = 0;
    for &stride in strides {
        let here = cells(size, &[stride]);
        if anchor < first + here {
            let cell = anchor - first;
            let columns = (size.width / stride) as usize;
            return Some(AnchorCell {
                column: (cell % columns) as f64,
                line: (cell / columns) as f64,
                stride: f64::from(stride),
            });
        }
        first += here;
    }
    None
}

/// The corners of a box that is written by its cell: offsets of the centre in cells, logarithms of the sides in cells.
fn in_cell(
    [x, y, width, height]: [f64; 4],
    strides: &[u32],
    size: PictureSize,
    anchor: usize,
) -> Corners {
    let Some(cell) = cell_of(anchor, strides, size) else {
        // Not reached: there are as many anchors as cells.
        return around([f64::NAN; 4]);
    };
    around([
        (x + cell.column) * cell.stride,
        (y + cell.line) * cell.stride,
        width.exp() * cell.stride,
        height.exp() * cell.stride,
    ])
}

/// True if scores are logits: most of them are no probabilities. A few that are none are faults.
pub(super) fn are_logits(scores: impl Iterator<Item = f32>) -> bool {
    let mut total = 0_usize;
    let mut outside = 0_usize;
    for score in scores {
        total += 1;
        outside += usize::from(score.is_finite() && !is_score(score));
    }
    2 * outside > total
}

/// The class with the largest logit, and its probability; `None` if one of them is not a number.
fn best_logit(logits: &[f32]) -> Option<(ClassId, f32)> {
    let mut best = 0;
    let mut largest = f32::NEG_INFINITY;
    for (class, &logit) in logits.iter().enumerate() {
        if logit.is_nan() {
            return None;
        }
        if logit > largest {
            best = class;
            largest = logit;
        }
    }
    let class = u16::try_from(best).ok()?;
    Some((ClassId(class), sigmoid(largest)))
}

/// The probability of a logit.
pub(super) fn sigmoid(logit: f32) -> f32 {
    1.0 / (1.0 + (-logit).exp())
}

impl ReadOutputs for Dense {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let anchors = self.anchors(outputs)?;
        let writing = self.writing(&anchors);
        let first_score = |anchor: Anchor<'_>| match anchor.objectness {
            Some(objectness) => objectness,
            None => anchor.scores.first().copied().unwrap_or_default(),
        };
        let has_logits = are_logits(anchors.rows().map(first_score));
        for (number, anchor) in anchors.rows().enumerate() {
            let objectness = match anchor.objectness {
                Some(logit) if has_logits => sigmoid(logit),
                Some(probability) => probability,
                None => 1.0,
            };
            // Class scores are at most 1, so most anchors end here. NaN is not skipped, so that it is counted.
            if f64::from(objectness) < rows.confidence {
                continue;
            }
            let best = if has_logits {
                best_logit(anchor.scores)
            } else {
                best_class(anchor.scores)
            };
            match best {
                Some((_, score)) if f64::from(score) < rows.confidence => {}
                Some((class, score)) if is_score(objectness) => {
                    let corners = self.corners(anchor.sides, writing, number);
                    rows.add(candidate(corners, class, objectness * score));
                }
                _ => rows.add(None),
            }
        }
        Ok(())
    }

    fn evidence(&self, outputs: &[TensorView<'_>], confidence: f64) -> Evidence {
        let Ok(anchors) = self.anchors(outputs) else {
            return Evidence::None;
        };
        let writing = self.writing(&anchors);
        let is_in_sides = self.form == BoxForm::CentreInSides;
        if is_in_sides && unit(anchors.sides(), self.size) == Unit::Pixels {
            return Evidence::against("its boxes are in pixels, and not from 0 to 1");
        }
        // Logarithms of sides shorter than a cell are negative, and sides never are.
        let is_negative = |anchor: &Anchor<'_>| {
            let [_, _, right_or_width, lower_or_height] = anchor.sides;
            right_or_width < -1e-3 || lower_or_height < -1e-3
        };
        let total = anchors.boxes.len() / anchors.box_row;
        // One in ten: a few are faults.
        let are_many = 10 * anchors.rows().filter(is_negative).count() > total;
        if are_many {
            return match writing {
                Writing::Cells(_) => Evidence::For,
                Writing::Unit(_) => {
                    Evidence::against("the sides of its boxes are negative: it is not decoded")
                }
            };
        }
        // Centre and sides in place of two corners; equal numbers decide nothing.
        let is_reversed = |anchor: &Anchor<'_>| {
            let [x1, y1, x2, y2] = anchor.sides;
            x2 < x1 || y2 < y1
        };
        let is_corners = self.form == BoxForm::Corners;
        if is_corners && 2 * anchors.rows().filter(is_reversed).count() > total {
            return Evidence::against(
                "the right and lower sides of its boxes are not beyond the left and upper ones",
            );
        }
        if let Writing::Unit(unit) = writing
            && self.form == BoxForm::Centre
            && are_corners(anchors.sides(), unit, self.size)
        {
            return corners_not_centres();
        }
        let mut of_a_class = 0_usize;
        let mut of_none = 0_usize;
        for anchor in anchors.rows() {
            let is_sure = anchor.objectness.is_some_and(|it| f64::from(it) >= confidence);
            if !is_sure {
                continue;
            }
            if anchor.scores.iter().all(|&score| score == 0.0) {
                of_none += 1;
            } else {
                of_a_class += 1;
            }
        }
        if of_none > of_a_class {
            return Evidence::against("its surest boxes have no class at all");
        }
        Evidence::None
    }
}

/// The number of anchors and classes of an output `[1, anchors, before + classes]`.
pub(super) fn rows_with_classes(shape: &[i64], before: usize) -> Result<(i64, usize), String> {
    match *shape {
        [1 | -1, anchors, row] if count(row) > before && (anchors == -1 || anchors > 0) => {
            let classes = count(row) - before;
            if classes > usize::from(u16::MAX) {
                return Err(format!("it has {classes} classes"));
            }
            Ok((anchors, classes))
        }
        _ => Err(format!(
            "its output has another shape than [1, anchors, {before} + classes]: {}",
            shape_text(shape)
        )),
    }
}
