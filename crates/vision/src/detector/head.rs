//! Heads: pure functions from a model's output tensors to candidates, one file per head.

mod detr;
mod end_to_end;
mod fastestdet;
mod reading;
mod recognise;
mod suppression;
mod yolo;
mod yolox;

pub use recognise::recognise;
pub use suppression::{Suppression, keep_best, suppress};

use super::{HeadName, PictureInput, Signature};
use crate::picture::{ColorOrder, Fit, InputFormat, ValueRange};
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;
use reading::Rows;

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
        let mut rows = Rows {
            confidence,
            candidates,
            rejected: 0,
        };
        self.reader.read(outputs, &mut rows)?;
        Ok(rows.rejected)
    }
}

/// [`Head::read`] for one kind of outputs.
trait ReadOutputs: std::fmt::Debug {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String>;
}

/// The number of classes, if the outputs show it, and what reads them; or the first difference to what the head expects.
type Bound = Result<(Option<usize>, Box<dyn ReadOutputs>), String>;

/// Binds the head `name` to a model with `signature` whose picture input is `input`. [`HeadName::Auto`] never fits:
/// [`recognise`] finds the name.
///
/// # Errors
/// If this head cannot read the model: the first difference.
pub fn bind(name: HeadName, signature: &Signature, input: PictureInput) -> Result<Head, String> {
    use ColorOrder::{Bgr, Rgb};
    use Fit::{Centre, Stretch, TopLeft};
    use ValueRange::{ImageNet, To255, ToOne};
    let size = input.size;
    let (bound, fit, color_order, value_range, overlaps) = match name {
        HeadName::Auto => return Err("the model was not recognised before".to_owned()),
        HeadName::Yolo => (yolo::bind(signature), Centre, Rgb, ToOne, true),
        HeadName::EndToEnd => (end_to_end::bind(signature), Centre, Rgb, ToOne, false),
        HeadName::Detr => (detr::bind(signature, size), Stretch, Rgb, ImageNet, false),
        HeadName::Yolox => (yolox::bind(signature, size), TopLeft, Bgr, To255, true),
        HeadName::FastestDet => (fastestdet::bind(signature, size), Stretch, Bgr, ToOne, true),
    };
    let (classes, reader) = bound?;
    Ok(Head {
        name,
        classes,
        input_format: input.format(fit, color_order, value_range),
        overlaps,
        reader,
    })
}

#[cfg(test)]
pub(in crate::detector) mod tests;
