//! Heads: pure functions from a model's output tensors to candidates, one file a head.

mod demonstration;
mod suppression;
mod yolox;

pub use suppression::{MOST_CANDIDATES, suppress};

use super::{HeadName, Signature};
use crate::detection::ClassId;
use crate::frame::InputFormat;
use crate::geometry::Corners;

/// An output tensor of float32, borrowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TensorView<'a> {
    /// Its dimensions.
    pub shape: &'a [i64],
    /// Its elements, the last dimension fastest.
    pub values: &'a [f32],
}

/// A box that a head has read, before suppression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// In pixels of the model's input.
    pub corners: Corners,
    /// The most probable class.
    pub class: ClassId,
    /// Confidence, 0 to 1.
    pub confidence: f32,
}

/// Why a model does not fit a head.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misfit {
    /// What the head expects, in words.
    pub expected: String,
    /// The first thing that differs.
    pub reason: String,
}

/// A head bound to a model that fits it.
#[derive(Clone, Debug, PartialEq)]
pub enum Head {
    /// See [`HeadName::Yolox`].
    Yolox(yolox::Yolox),
    /// See [`HeadName::Demonstration`].
    Demonstration(demonstration::Demonstration),
}

impl Head {
    /// Binds the head of that name to a model with `signature` and `classes` classes.
    ///
    /// # Errors
    /// When the model is not one that this head reads.
    pub fn bind(name: HeadName, signature: &Signature, classes: usize) -> Result<Self, Misfit> {
        match name {
            HeadName::Yolox => yolox::Yolox::bind(signature, classes).map(Self::Yolox),
            HeadName::Demonstration => {
                demonstration::Demonstration::bind(signature, classes).map(Self::Demonstration)
            }
        }
    }

    /// What the model wants to see.
    pub fn input_format(&self) -> InputFormat {
        match self {
            Self::Yolox(head) => head.input_format(),
            Self::Demonstration(head) => head.input_format(),
        }
    }

    /// Appends to `candidates` what has at least `confidence`, in input pixels, overlaps not suppressed.
    /// Returns how many rows were rejected because a number in them is not finite or not possible.
    ///
    /// # Errors
    /// When the outputs are not of the shape the model announced, in words.
    pub fn read(
        &self,
        outputs: &[TensorView<'_>],
        confidence: f64,
        candidates: &mut Vec<Candidate>,
    ) -> Result<u64, String> {
        match self {
            Self::Yolox(head) => head.read(
                rows(outputs, head.cells(), head.row())?,
                confidence,
                candidates,
            ),
            Self::Demonstration(head) => head.read(
                rows(outputs, head.cells(), head.row())?,
                confidence,
                candidates,
            ),
        }
    }
}

impl HeadName {
    /// The name in configuration and messages.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Yolox => "yolox",
            Self::Demonstration => "demonstration",
        }
    }
}

/// The elements of the only output, which must be `[1, cells, row]`.
fn rows<'a>(outputs: &[TensorView<'a>], cells: usize, row: usize) -> Result<&'a [f32], String> {
    let [output] = outputs else {
        return Err(format!(
            "the model gave {} outputs instead of one",
            outputs.len()
        ));
    };
    let expected = [1, cells as i64, row as i64];
    if output.shape != expected || output.values.len() != cells * row {
        return Err(format!(
            "the model gave an output of {:?} instead of {expected:?}",
            output.shape
        ));
    }
    Ok(output.values)
}

/// The number of the largest score and the score; `None` when one is not a number or outside 0 to 1, beyond
/// what rounding explains.
fn best_class(scores: &[f32]) -> Option<(ClassId, f32)> {
    let mut best = (0, f32::NEG_INFINITY);
    for (class, &score) in scores.iter().enumerate() {
        if !(-1e-3..=1.001).contains(&score) {
            return None;
        }
        if score > best.1 {
            best = (class, score);
        }
    }
    let class = u16::try_from(best.0).ok()?;
    (!scores.is_empty()).then_some((ClassId(class), best.1.clamp(0.0, 1.0)))
}

/// Whether the four numbers are finite and enclose an area.
fn is_possible(corners: Corners) -> bool {
    let Corners { x1, y1, x2, y2 } = corners;
    [x1, y1, x2, y2].iter().all(|value| value.is_finite()) && x2 > x1 && y2 > y1
}

#[cfg(test)]
mod tests;
