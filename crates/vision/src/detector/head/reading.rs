//! What the heads share: looking for outputs, checking shapes, boxes from numbers.

use super::{Candidate, Misfit, TensorView};
use crate::detector::{HeadName, PictureInput, shape_text};
use crate::picture::{ColorOrder, Fit, InputFormat, ValueRange};
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};

/// Strides of the three feature maps that YOLO models have.
pub(super) const STRIDES: [u32; 3] = [8, 16, 32];

/// Cells of all strides in an input of `size`.
pub(super) fn cells(size: PictureSize, strides: &[u32]) -> usize {
    strides
        .iter()
        .map(|stride| (size.width / stride) as usize * (size.height / stride) as usize)
        .sum()
}

/// Whether a dimension of the model, which may be open, can be `wanted`.
pub(super) fn can_be(dimension: i64, wanted: usize) -> bool {
    dimension == -1 || usize::try_from(dimension) == Ok(wanted)
}

/// A dimension as a count.
pub(super) fn count(dimension: i64) -> usize {
    usize::try_from(dimension).unwrap_or(0)
}

/// How `name`'s misfits say what is expected.
pub(super) fn misfit(name: HeadName) -> impl Fn(String) -> Misfit {
    move |reason| Misfit {
        expected: name.looks_for().to_owned(),
        reason,
    }
}

/// The format for a model with this input.
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
        // A model that takes bytes does the rest itself.
        value_range: if input.takes_bytes {
            ValueRange::To255
        } else {
            value_range
        },
        layout: input.layout,
    }
}

/// The elements of the only output, which must be of that shape; -1 matches any dimension.
pub(super) fn only<'a>(outputs: &[TensorView<'a>], expected: &[i64]) -> Result<&'a [f32], String> {
    match outputs {
        [output] => elements(output, expected),
        _ => Err(format!(
            "the model gave {} outputs instead of one",
            outputs.len()
        )),
    }
}

/// The elements of `output`, which must be of that shape; -1 matches any dimension.
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
            "the model gave an output of {} instead of {}",
            shape_text(output.shape),
            shape_text(expected)
        ));
    }
    Ok(output.values)
}

/// Whether `score` is a number from 0 to 1, beyond what rounding (of float16 too) explains.
pub(super) fn is_score(score: f32) -> bool {
    (-1e-3..=1.001).contains(&score)
}

/// The number of the largest score and the score; `None` when one is no score.
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

/// The corners that a row begins with: x1, y1, x2, y2.
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

/// The candidate, when its corners are finite and enclose an area and its confidence is a score.
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
