//! Heads: pure functions from a model's output tensors to candidates. The table in `families.rs` says what each head
//! expects; `dense.rs`, `yolo.rs`, `yolox.rs`, `columns.rs`, `detr.rs`, `pair.rs`, `rt_detr.rs` and `fastestdet.rs` are the
//! arithmetic.

mod columns;
mod dense;
mod detr;
mod families;
mod fastestdet;
mod pair;
mod reading;
mod recognise;
mod rt_detr;
mod suppression;
mod unread;
mod yolo;
mod yolox;

pub use columns::ColumnList;
pub(in crate::detector) use families::is_cells;
pub use recognise::{
    LEAST_SCORE, Recognised, RecognisedHead, assumed_of_nothing, misfit, recognise, way_out,
};
pub use suppression::{Suppression, keep_best, suppress};

use super::{HeadName, HeadSetting};
use crate::onnx::{PictureInput, Signature, TensorView};
use crate::picture::{ColorOrder, Fit, InputFormat, ValueRange};
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;
use families::{Family, family};
use reading::Rows;
use std::fmt;

/// A box that a head has read, before suppression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// In pixels of the model's input.
    pub corners: Corners,
    /// The most probable class, by its number in the model. Models with final boxes give the number themselves, so the
    /// model may have no name for it.
    pub class: ClassId,
    /// Confidence, 0 to 1.
    pub confidence: f32,
}

/// How a model wants its pictures where that is configured; `None` is as its head says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HeadOverrides {
    /// The range of the values.
    pub value_range: Option<ValueRange>,
    /// The order of the colours.
    pub color_order: Option<ColorOrder>,
    /// The way a picture is fitted to the input.
    pub fit: Option<Fit>,
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
    reader: Box<dyn ReadOutputs>,
}

/// What the values of a run say about a head.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// They are what this head reads.
    For,
    /// They are something else.
    Against(Objection),
    /// They decide nothing.
    None,
}

impl Evidence {
    /// Evidence against the head, with no other remedy than another head.
    fn against(reason: impl Into<String>) -> Self {
        Self::Against(Objection {
            reason: reason.into(),
            remedy: None,
        })
    }

    /// Evidence against the head, with what reads the model or makes it readable.
    fn against_with(reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Against(Objection {
            reason: reason.into(),
            remedy: Some(remedy.into()),
        })
    }
}

/// What a run says against a head; written with what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Objection {
    /// What its numbers are.
    pub reason: String,
    /// What to do about it, as a sentence without its full stop; `None` for what helps against any wrong head.
    pub remedy: Option<String>,
}

impl fmt::Display for Objection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let general = "Set detector.head to another, or list the columns of its output, in their order: detector.head = { \
                       columns = \"x1 y1 x2 y2 score class\" }";
        let remedy = self.remedy.as_deref().unwrap_or(general);
        write!(f, "{}. {remedy}", self.reason)
    }
}

impl Head {
    fn new(name: HeadName, bound: Bound, input_format: InputFormat) -> Self {
        Self {
            name,
            classes: bound.classes,
            input_format,
            reader: bound.reader,
        }
    }

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
            size: self.input_format.size,
            rejected: 0,
        };
        self.reader.read(outputs, &mut rows)?;
        Ok(rows.rejected)
    }

    /// True if one object may have several overlapping boxes in the outputs of this run, which the program then suppresses.
    pub fn overlaps_in(&self, outputs: &[TensorView<'_>]) -> bool {
        self.reader.overlaps_in(outputs)
    }

    /// What the outputs of a run say about this head, by rows of at least `confidence`.
    pub fn evidence(&self, outputs: &[TensorView<'_>], confidence: f64) -> Evidence {
        self.reader.evidence(outputs, confidence)
    }

    /// True if the model can have this number of class names. Models of the DETR family may end with a class for "no
    /// object".
    pub(super) fn fits_names(&self, names: usize) -> bool {
        let Some(classes) = self.classes else {
            return true;
        };
        let may_have_background = matches!(self.name, HeadName::Detr | HeadName::RtDetr);
        classes == names || (may_have_background && classes == names + 1)
    }
}

/// [`Head::read`], [`Head::overlaps_in`] and [`Head::evidence`] for one kind of outputs.
trait ReadOutputs: std::fmt::Debug + Send {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String>;

    /// Several cells show one object, unless a head says otherwise.
    fn overlaps_in(&self, _outputs: &[TensorView<'_>]) -> bool {
        true
    }

    fn evidence(&self, _outputs: &[TensorView<'_>], _confidence: f64) -> Evidence {
        Evidence::None
    }
}

/// A head's reader for one model.
struct Bound {
    /// The number of classes, if the outputs show it.
    classes: Option<usize>,
    reader: Box<dyn ReadOutputs>,
}

impl HeadName {
    /// The outputs of its models, in words.
    pub(super) fn looks_for(self) -> &'static str {
        family(self).map_or("outputs with these columns", |family| family.looks_for)
    }
}

/// Binds a head to a model with `signature` whose picture input is `input`. [`HeadName::Auto`] never fits: [`recognise`]
/// finds the name.
///
/// # Errors
/// If this head cannot read the model: the first difference.
pub fn bind(
    setting: &HeadSetting,
    signature: &Signature,
    input: PictureInput,
    overrides: HeadOverrides,
) -> Result<Head, String> {
    match setting {
        HeadSetting::Columns(list) => {
            let bound = columns::bind(list, signature, input.size)?;
            // As most exports with suppression inside want their pictures.
            let format = input.format(
                overrides.fit.unwrap_or(Fit::Centre),
                overrides.color_order.unwrap_or(ColorOrder::Rgb),
                overrides.value_range.unwrap_or(ValueRange::ToOne),
            );
            Ok(Head::new(HeadName::Columns, bound, format))
        }
        HeadSetting::Named(name) => match family(*name) {
            Some(family) => bind_family(family, signature, input, overrides),
            None => Err("the model was not recognised before".to_owned()),
        },
    }
}

fn bind_family(
    family: &Family,
    signature: &Signature,
    input: PictureInput,
    overrides: HeadOverrides,
) -> Result<Head, String> {
    let bound = (family.bind)(signature, input.size)?;
    let format = input.format(
        overrides.fit.unwrap_or(family.fit),
        overrides.color_order.unwrap_or(family.color_order),
        overrides.value_range.unwrap_or(family.value_range),
    );
    Ok(Head::new(family.name, bound, format))
}

#[cfg(test)]
pub(in crate::detector) mod tests;
