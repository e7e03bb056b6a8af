//! Functions that the heads share: finding outputs, checking shapes, making boxes from numbers.

use super::{Candidate, Misfit, TensorView};
use crate::detector::{HeadName, PictureInput, shape_text};
use crate::picture::{ColorOrder, Fit, InputFormat, ValueRange};
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

/// True if a dimension of the model, which may be open, can be `wanted`.
pub(super) fn can_be(dimension: i64, wanted: usize) -> bool {
    dimension == -1 || usize::try_from(dimension) == Ok(wanted)
}

/// A dimension as a count; 0 if it is open.
pub(super) fn count(dimension: i64) -> usize {
    usize::try_from(dimension).unwrap_or(0)
}

/// Makes misfits for the head `name` from their reasons.
pub(super) fn misfit(name: HeadName) -> impl Fn(String) -> Misfit {
    move |reason| Misfit {
        expected: name.looks_for().to_owned(),
        reason,
    }
}

/// The input format for a model with this input.
pub(super) fn format(
    input: PictureInput,
    fit: Fit,
    color_order: ColorOrder,
    value_range: ValueRange,
) -> InputFormat {
    InputFormat {
        size: input.size,
        fit,
        color_order,
        // A model that takes bytes normalises them itself.
        value_range: if input.takes_bytes {
            ValueRange::To255
        } else {
            value_range
        },
        layout: input.layout,
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
    let fits = output.shape.len() == expected.len()
        && output
            .shape
            .iter()
            .zip(expected)
            .all(|(&actual, &expected)| actual >= 0 && (expected == -1 || actual == expected));
    let length = output
        .shape
        .iter()
        .try_fold(1_i64, |product, &side| product.checked_mul(side));
    if !fits || length.and_then(|length| usize::try_from(length).ok()) != Some(output.values.len())
    {
        return Err(format!(
            "the model returned an output of {} instead of {}",
            shape_text(output.shape),
            shape_text(expected)
        ));
    }
    Ok(output.values)
}

/// True if `score` is a number from 0 to 1, within rounding (of float16 too).
pub(super) fn is_score(score: f32) -> bool {
    (-1e-3..=1.001).contains(&score)
}

/// The class with the largest score, and that score; `None` if one of the numbers is not a score.
pub(super) fn best_class(scores: &[f32]) -> Option<(ClassId, f32)> {
    let mut best = (0, f32::NEG_INFINITY);
    for (class, &score) in scores.iter().enumerate() {
        if !is_score(score) {
            return None;
        }
        if score > best.1 {
            best = (class, score);
        }
    }
    let class = u16::try_from(best.0).ok()?;
    (!scores.is_empty()).then_some((ClassId(class), best.1.clamp(0.0, 1.0)))
}

/// The corners at the start of a row: x1, y1, x2, y2.
pub(super) fn corners(row: &[f32]) -> Corners {
    Corners {
        x1: f64::from(row[0]),
        y1: f64::from(row[1]),
        x2: f64::from(row[2]),
        y2: f64::from(row[3]),
    }
}

/// The corners of a box with this centre and these sides.
pub(super) fn around(center_x: f64, center_y: f64, width: f64, height: f64) -> Corners {
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
    possible.then(|| Candidate {
        corners,
        class,
        confidence: confidence.clamp(0.0, 1.0),
    })
}
