//! The signature of a model: names, element types and shapes of its inputs and outputs, and metadata.

use super::Metadata;
use crate::picture::{ColorOrder, Fit, InputElement, InputFormat, TensorLayout, ValueRange};
use albireo_core::geometry::PictureSize;
use std::fmt;

/// The maximum number of pixels of an input: 200 MB as float32. A hostile file cannot ask for more.
const MOST_PIXELS: u64 = 4096 * 4096;

/// The longest side of an input.
const LONGEST_SIDE: u32 = 8192;

/// The type of a tensor's elements, as far as it matters here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ElementType {
    /// IEEE 754 binary32.
    Float32,
    /// IEEE 754 binary16.
    Float16,
    /// Bytes of an input: unchanged pixel values.
    Uint8,
    /// Whole numbers of 32 bits.
    Int32,
    /// Whole numbers of 64 bits.
    Int64,
    /// Whole numbers of any other kind, those of an output's bytes among them, by their name.
    Whole(&'static str),
    /// Any other type, by its name.
    Other(String),
}

/// One input or output of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorSpec {
    /// Its name in the graph.
    pub name: String,
    /// The type of its elements.
    pub element: ElementType,
    /// Its dimensions; -1 for one that the model leaves open.
    pub shape: Vec<i64>,
}

/// A model's inputs, outputs and metadata.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signature {
    /// The inputs.
    pub inputs: Vec<TensorSpec>,
    /// The outputs.
    pub outputs: Vec<TensorSpec>,
    /// The text in its file beside the graph.
    pub metadata: Metadata,
}

/// A picture input: batch 1, three colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureInput {
    /// Columns and rows.
    pub size: PictureSize,
    /// The order of colours, rows and columns.
    pub layout: TensorLayout,
    /// True if it takes bytes, which are then pixel values from 0 to 255.
    pub takes_bytes: bool,
}

impl PictureInput {
    /// The input of a network that is made for pictures of this kind.
    pub(crate) fn format(
        self,
        fit: Fit,
        color_order: ColorOrder,
        value_range: ValueRange,
    ) -> InputFormat {
        InputFormat {
            size: self.size,
            fit,
            color_order,
            // A model that takes bytes normalises them itself.
            value_range: if self.takes_bytes {
                ValueRange::To255
            } else {
                value_range
            },
            layout: self.layout,
            element: if self.takes_bytes {
                InputElement::Byte
            } else {
                InputElement::Float
            },
        }
    }
}

/// An input beside the picture, by which a model learns of the picture's size. Exporters write its numbers as whole ones or
/// not, with a dimension for the batch or without.
struct BesidePicture {
    name: &'static str,
    /// Its two numbers for an input of some columns and rows.
    numbers: fn(f32, f32) -> [f32; 2],
}

/// The inputs beside the picture that exporters write. With these numbers a model answers in pixels of its input.
const BESIDE_PICTURE: [BesidePicture; 3] = [
    // D-FINE, DEIM and RT-DETR of its authors.
    BesidePicture {
        name: "orig_target_sizes",
        numbers: |columns, rows| [columns, rows],
    },
    // PaddleDetection.
    BesidePicture {
        name: "scale_factor",
        numbers: |_, _| [1.0, 1.0],
    },
    BesidePicture {
        name: "im_shape",
        numbers: |columns, rows| [rows, columns],
    },
];

impl Signature {
    /// Returns the model's only picture input: float32, float16 or uint8, `[1, 3, rows, columns]` or
    /// `[1, rows, columns, 3]`. An open batch dimension counts as 1, open colours as 3. Open sides come from `wanted`, else
    /// from the metadata.
    ///
    /// # Errors
    /// The problem with the inputs or with `wanted`.
    pub fn picture_input(&self, wanted: Option<PictureSize>) -> Result<PictureInput, String> {
        let input = self.only_picture()?;
        if !matches!(
            input.element,
            ElementType::Float32 | ElementType::Float16 | ElementType::Uint8
        ) {
            return Err(format!(
                "the elements of its input are {} instead of float32, float16 or uint8",
                input.element
            ));
        }
        let (batch, layout, rows, columns) = match *input.shape.as_slice() {
            [batch, 3, rows, columns] => (batch, TensorLayout::Nchw, rows, columns),
            [batch, rows, columns, 3] => (batch, TensorLayout::Nhwc, rows, columns),
            [batch, -1, rows, columns] => (batch, TensorLayout::Nchw, rows, columns),
            _ => {
                let reason = "its input is neither [1, 3, rows, columns] nor [1, rows, columns, 3]";
                return Err(reason.to_owned());
            }
        };
        if batch != 1 && batch != -1 {
            return Err(format!(
                "its input takes {batch} pictures at once; export it with a batch of 1 or an open one"
            ));
        }
        let offered = wanted.or_else(|| self.metadata.image_size());
        let size = PictureSize::new(
            side(columns, offered.map(|size| size.width))?,
            side(rows, offered.map(|size| size.height))?,
        );
        if let Some(wanted) = wanted
            && wanted != size
        {
            return Err(format!("its input is {size} and cannot be {wanted}"));
        }
        if size.pixels() > MOST_PIXELS {
            return Err(format!(
                "its input of {size} has more than 4096x4096 pixels"
            ));
        }
        Ok(PictureInput {
            size,
            layout,
            takes_bytes: input.element == ElementType::Uint8,
        })
    }

    /// True if the sides of the picture input are open, and neither `wanted` nor the metadata name any.
    pub(crate) fn lacks_size(&self, wanted: Option<PictureSize>) -> bool {
        let has_open = |input: &TensorSpec| input.shape.iter().skip(1).any(|&side| side == -1);
        let is_named = wanted.is_some() || self.metadata.image_size().is_some();
        // Any size that a model may have shows whether a size is all that is missing.
        let any_size = PictureSize::new(640, 640);
        self.picture().is_some_and(has_open)
            && !is_named
            && self.picture_input(Some(any_size)).is_ok()
    }

    /// True if the model leaves both height and width of its picture input open.
    pub(crate) fn has_open_sides(&self) -> bool {
        let shape = self.picture().map(|input| input.shape.as_slice());
        matches!(shape, Some([_, 3 | -1, -1, -1] | [_, -1, -1, 3]))
    }

    /// The shapes of all inputs for `batch` pictures at an input of `size`, as TensorRT's profiles are written. A batch that
    /// is not open stays.
    pub(crate) fn shapes(&self, size: PictureSize, batch: usize) -> String {
        let height = i64::from(size.height);
        let width = i64::from(size.width);
        let batch = batch as i64;
        let mut shapes = Vec::new();
        for input in &self.inputs {
            // What each dimension is where the model leaves it open.
            let when_open = if input.is_beside_picture() {
                [batch, 2, 2, 2]
            } else if let [_, _, _, 3] = *input.shape.as_slice() {
                [batch, height, width, 3]
            } else {
                [batch, 3, height, width]
            };
            let mut sides = Vec::new();
            for (&of_model, open) in input.shape.iter().zip(when_open) {
                let side = if of_model >= 0 { of_model } else { open };
                sides.push(side.to_string());
            }
            shapes.push(format!("{}:{}", input.name, sides.join("x")));
        }
        shapes.join(",")
    }

    /// The first input that is not one of those beside the picture.
    pub(super) fn picture(&self) -> Option<&TensorSpec> {
        self.inputs.iter().find(|input| !input.is_beside_picture())
    }

    /// The only input that is a picture; all others must be known inputs beside it.
    fn only_picture(&self) -> Result<&TensorSpec, String> {
        let is_misfit =
            |input: &&TensorSpec| input.known_name().is_some() && !input.is_beside_picture();
        if let Some(misfit) = self.inputs.iter().find(is_misfit) {
            return Err(format!(
                "what its input {misfit} should get is not known: beside a picture it takes two numbers, [1, 2] or \
                 [2], of int32, int64 or float32"
            ));
        }
        let pictures: Vec<_> =
            self.inputs.iter().filter(|input| !input.is_beside_picture()).collect();
        match pictures.as_slice() {
            [picture] => Ok(picture),
            [] => Err(format!(
                "none of its {} inputs is a picture",
                self.inputs.len()
            )),
            [_, other, ..] => {
                let known: Vec<_> =
                    BESIDE_PICTURE.iter().map(|beside| format!("`{}`", beside.name)).collect();
                Err(format!(
                    "it has {} inputs, and what `{}` should get is not known (known beside a picture are {}, two \
                     numbers each)",
                    self.inputs.len(),
                    other.name,
                    known.join(", ")
                ))
            }
        }
    }

    /// Returns the model's only output, which must be float32 or float16.
    ///
    /// # Errors
    /// The problem with the outputs.
    pub(crate) fn only_output(&self) -> Result<&TensorSpec, String> {
        let [output] = self.outputs.as_slice() else {
            return Err(format!(
                "it has {} outputs instead of one",
                self.outputs.len()
            ));
        };
        output.float()
    }

    /// Returns the output `name` and its index.
    ///
    /// # Errors
    /// If there is none.
    pub fn output(&self, name: &str) -> Result<(usize, &TensorSpec), String> {
        self.outputs
            .iter()
            .enumerate()
            .find(|(_, output)| output.name == name)
            .ok_or_else(|| format!("it has no output `{name}`"))
    }
}

impl TensorSpec {
    /// This output, if it is float32 or float16.
    ///
    /// # Errors
    /// If it has other elements.
    pub(crate) fn float(&self) -> Result<&Self, String> {
        if matches!(self.element, ElementType::Float32 | ElementType::Float16) {
            Ok(self)
        } else {
            Err(format!(
                "the elements of its output `{}` are {} instead of float32 or float16",
                self.name, self.element
            ))
        }
    }

    /// The numbers of this input beside a picture of `size`; `None` if it is no such input.
    pub(super) fn beside_picture(&self, size: PictureSize) -> Option<[f32; 2]> {
        let known = self.known_name()?;
        let are_two = matches!(self.shape.as_slice(), [_, 2 | -1] | [2]);
        let are_numbers = matches!(
            self.element,
            ElementType::Int32 | ElementType::Int64 | ElementType::Float32
        );
        if !are_two || !are_numbers {
            return None;
        }
        Some((known.numbers)(size.width as f32, size.height as f32))
    }

    /// The input beside the picture that has this name.
    fn known_name(&self) -> Option<&'static BesidePicture> {
        BESIDE_PICTURE.iter().find(|known| known.name == self.name)
    }

    fn is_beside_picture(&self) -> bool {
        self.beside_picture(PictureSize::new(1, 1)).is_some()
    }
}

/// A side of the input: the model's, else the offered one.
fn side(model: i64, offered: Option<u32>) -> Result<u32, String> {
    let side = match (model, offered) {
        (-1, Some(side)) => i64::from(side),
        (-1, None) => {
            let reason = "its input size is open; export it with a fixed size, or for a detector name one in \
                          detector.input_size";
            return Err(reason.to_owned());
        }
        (side, _) => side,
    };
    match u32::try_from(side) {
        Ok(side @ 1..=LONGEST_SIDE) => Ok(side),
        _ => Err(format!(
            "the sides of its input are not between 1 and {LONGEST_SIDE}"
        )),
    }
}

/// True if an input can have this size.
pub(super) fn is_possible(size: PictureSize) -> bool {
    let is_side = |side: u32| (1..=LONGEST_SIDE).contains(&side);
    is_side(size.width) && is_side(size.height) && size.pixels() <= MOST_PIXELS
}

impl fmt::Display for ElementType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Self::Float32 => "float32",
            Self::Float16 => "float16",
            Self::Uint8 => "uint8",
            Self::Int32 => "int32",
            Self::Int64 => "int64",
            Self::Whole(name) => *name,
            Self::Other(other) => other.as_str(),
        };
        f.write_str(name)
    }
}

impl fmt::Display for TensorSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "`{}` {} {}",
            self.name,
            self.element,
            shape_text(&self.shape)
        )
    }
}

/// A shape as written in messages: `[1, 3, ?, ?]`.
pub(crate) fn shape_text(shape: &[i64]) -> String {
    let sides: Vec<_> = shape
        .iter()
        .map(|side| match side {
            -1 => "?".to_owned(),
            side => side.to_string(),
        })
        .collect();
    format!("[{}]", sides.join(", "))
}

impl fmt::Display for Signature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |specs: &[TensorSpec]| {
            specs.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
        };
        let plural = |specs: &[TensorSpec]| if specs.len() == 1 { "" } else { "s" };
        write!(
            f,
            "input{} {} and output{} {}",
            plural(&self.inputs),
            list(&self.inputs),
            plural(&self.outputs),
            list(&self.outputs)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(name: &str, element: ElementType, shape: &[i64]) -> TensorSpec {
        TensorSpec {
            name: name.to_owned(),
            element,
            shape: shape.to_vec(),
        }
    }

    /// A model with an input beside its picture.
    fn with(beside: TensorSpec) -> Signature {
        Signature {
            inputs: vec![
                beside,
                spec("images", ElementType::Float32, &[1, 3, 32, 64]),
            ],
            outputs: Vec::new(),
            metadata: Metadata::default(),
        }
    }

    #[test]
    fn the_size_beside_a_picture_is_filled_whatever_its_exporter_writes_it_as() {
        use ElementType::{Float32, Int32, Int64};
        for element in [Int32, Int64, Float32] {
            for shape in [&[1, 2][..], &[-1, 2], &[-1, -1], &[2]] {
                let beside = spec("orig_target_sizes", element.clone(), shape);
                let size = PictureSize::new(64, 32);
                assert_eq!(beside.beside_picture(size), Some([64.0, 32.0]));
                assert_eq!(with(beside).picture_input(None).unwrap().size, size);
            }
        }
    }

    #[test]
    fn an_input_beside_the_picture_that_is_not_filled_is_named_with_the_forms_that_are() {
        for (element, shape, said) in [
            (ElementType::Float16, &[1, 2][..], "float16 [1, 2]"),
            (ElementType::Int64, &[1, 4], "int64 [1, 4]"),
        ] {
            let model = with(spec("orig_target_sizes", element, shape));
            let refusal = model.picture_input(None).unwrap_err();
            for part in [said, "`orig_target_sizes`", "[2], of int32"] {
                assert!(refusal.contains(part), "{refusal}");
            }
        }
    }
}
