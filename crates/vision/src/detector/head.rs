//! Heads: pure functions from a model's output tensors to candidates, one file per head.

mod detr;
mod end_to_end;
mod fastestdet;
mod reading;
mod recognise;
mod suppression;
mod yolo;
mod yolox;

pub use recognise::{Unrecognised, recognise};
pub use suppression::{Suppression, keep_best, suppress};

use super::{HeadName, PictureInput, Signature};
use crate::picture::InputFormat;
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;

/// An output tensor as borrowed float32 values.
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
    /// The most probable class, by its number in the model. End-to-end models give the number themselves, so the model
    /// may have no name for it.
    pub class: ClassId,
    /// Confidence, 0 to 1.
    pub confidence: f32,
}

/// The reason why a model does not fit a head.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misfit {
    /// The model that the head expects.
    pub expected: String,
    /// The first difference.
    pub reason: String,
}

/// A head bound to a model that fits it.
#[derive(Debug)]
pub struct Head {
    /// The name of the head.
    pub name: HeadName,
    /// The number of classes in the outputs' shapes; `None` if they do not show it.
    pub classes: Option<usize>,
    /// The input that the model expects.
    pub input_format: InputFormat,
    /// True if one object may give several overlapping boxes, which the program then suppresses.
    pub overlaps: bool,
    reader: Box<dyn ReadOutputs>,
}

impl Head {
    /// Appends the boxes with at least `confidence` to `candidates`, in input pixels, overlaps not suppressed. Returns
    /// the number of rows rejected because a number in them is not finite or not possible.
    ///
    /// # Errors
    /// If the outputs do not have the shape that the model announced.
    pub fn read(
        &self,
        outputs: &[TensorView<'_>],
        confidence: f64,
        candidates: &mut Vec<Candidate>,
    ) -> Result<u64, String> {
        self.reader.read(outputs, confidence, candidates)
    }
}

/// [`Head::read`] for one kind of outputs.
trait ReadOutputs: std::fmt::Debug {
    fn read(
        &self,
        outputs: &[TensorView<'_>],
        confidence: f64,
        candidates: &mut Vec<Candidate>,
    ) -> Result<u64, String>;
}

/// Binds the head `name` to a model with `signature` whose picture input is `input`. [`HeadName::Auto`] never fits:
/// [`recognise`] finds the name.
///
/// # Errors
/// If this head cannot read the model.
pub fn bind(name: HeadName, signature: &Signature, input: PictureInput) -> Result<Head, Misfit> {
    match name {
        HeadName::Auto => Err(Misfit {
            expected: "a head".to_owned(),
            reason: "the model was not recognised before".to_owned(),
        }),
        HeadName::Yolo => yolo::bind(signature, input),
        HeadName::EndToEnd => end_to_end::bind(signature, input),
        HeadName::Detr => detr::bind(signature, input),
        HeadName::Yolox => yolox::bind(signature, input),
        HeadName::FastestDet => fastestdet::bind(signature, input),
    }
}

#[cfg(test)]
pub(in crate::detector) mod tests;
