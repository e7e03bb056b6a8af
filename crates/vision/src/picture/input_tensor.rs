//! The numbers of a network's input, as float32 or as bytes.

use super::input_format::{
    Conversion, InputElement, InputFormat, InputMapping, TensorLayout, place,
};
use albireo_core::geometry::PictureSize;
use std::borrow::Cow;

/// The numbers of an input, in the shape of its format.
#[derive(Clone, Debug, PartialEq)]
pub enum InputTensor {
    /// As float32.
    Floats(Vec<f32>),
    /// As bytes.
    Bytes(Vec<u8>),
}

impl InputTensor {
    /// Zeros for an input of `size`.
    pub(crate) fn zeros(element: InputElement, size: PictureSize) -> Self {
        let values = 3 * size.width as usize * size.height as usize;
        match element {
            InputElement::Float => Self::Floats(vec![0.0; values]),
            InputElement::Byte => Self::Bytes(vec![0; values]),
        }
    }

    /// Cuts the input of `size` out of this one, which is the largest of `format` and holds a picture of `source`; also
    /// returns its mapping.
    pub(crate) fn cut(
        &self,
        format: InputFormat,
        source: PictureSize,
        size: PictureSize,
    ) -> (Self, InputMapping) {
        let (from, _) = place(source, format, format.size);
        let (to, mapping) = place(source, format, size);
        let left = (from.left - to.left) as usize;
        let top = (from.top - to.top) as usize;
        let cut = match self {
            Self::Floats(values) => Self::Floats(window(values, format, size, left, top)),
            Self::Bytes(values) => Self::Bytes(window(values, format, size, left, top)),
        };
        (cut, mapping)
    }

    /// The numbers as float32; bytes keep their values.
    pub fn to_floats(&self) -> Cow<'_, [f32]> {
        match self {
            Self::Floats(values) => Cow::Borrowed(values),
            Self::Bytes(values) => values.iter().copied().map(f32::from).collect(),
        }
    }
}

/// A number of an input.
pub(super) trait Number: Copy {
    /// The number of a pixel's value, converted.
    fn of(value: u8, conversion: Conversion) -> Self;
}

impl Number for f32 {
    fn of(value: u8, conversion: Conversion) -> Self {
        conversion.apply(Self::from(value))
    }
}

impl Number for u8 {
    /// Bytes are pixel values, whatever the network makes of them.
    fn of(value: u8, _: Conversion) -> Self {
        value
    }
}

/// The part of `size` of the largest input of `format` that begins at column `left` and row `top`.
fn window<T: Copy>(
    values: &[T],
    format: InputFormat,
    size: PictureSize,
    left: usize,
    top: usize,
) -> Vec<T> {
    let rows = size.height as usize;
    let columns = size.width as usize;
    let full_width = format.size.width as usize;
    // Three planes of one colour each, or one of pixels with three values.
    let (planes, pixel_values) = match format.layout {
        TensorLayout::Nchw => (3, 1),
        TensorLayout::Nhwc => (1, 3),
    };
    let plane_values = pixel_values * full_width * format.size.height as usize;
    let mut part = Vec::with_capacity(3 * rows * columns);
    for plane in 0..planes {
        for row in 0..rows {
            let pixels_before = (top + row) * full_width + left;
            let start = plane * plane_values + pixels_before * pixel_values;
            part.extend_from_slice(&values[start..][..columns * pixel_values]);
        }
    }
    part
}
