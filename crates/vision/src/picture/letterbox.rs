//! Turns a decoded picture into the input tensor of a network, and maps the network's boxes back.

use super::{FrameFault, Picture};
use albireo_core::geometry::{BoundingBox, Corners, PictureSize};
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::error::Error;

/// The order of the colour planes that a network expects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum ColorOrder {
    /// Red, green, blue.
    Rgb,
    /// Blue, green, red.
    Bgr,
}

impl ColorOrder {
    /// Its name in configuration and messages.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Bgr => "bgr",
        }
    }
}

/// The grey of the margin, the same for YOLOX and Ultralytics.
const MARGIN: u8 = 114;

/// The way a picture is fitted to the network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Fit {
    /// Aspect ratio kept, in the top-left corner, the rest filled with grey (YOLOX).
    #[serde(rename = "letterbox-corner")]
    #[cfg_attr(feature = "cli", value(name = "letterbox-corner"))]
    TopLeft,
    /// Aspect ratio kept, in the middle, the rest filled with grey (Ultralytics).
    #[serde(rename = "letterbox")]
    #[cfg_attr(feature = "cli", value(name = "letterbox"))]
    Centre,
    /// Both sides stretched to those of the input.
    #[serde(rename = "stretch")]
    Stretch,
}

impl Fit {
    /// Its name in configuration and messages.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::TopLeft => "letterbox-corner",
            Self::Centre => "letterbox",
            Self::Stretch => "stretch",
        }
    }
}

/// The conversion of pixel values from 0 to 255.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum ValueRange {
    /// Unchanged.
    #[serde(rename = "0..255")]
    #[cfg_attr(feature = "cli", value(name = "0..255"))]
    To255,
    /// Divided by 255.
    #[serde(rename = "0..1")]
    #[cfg_attr(feature = "cli", value(name = "0..1"))]
    ToOne,
    /// Divided by 255, then normalised by the mean and standard deviation of their colour in ImageNet.
    #[serde(rename = "imagenet")]
    #[cfg_attr(feature = "cli", value(name = "imagenet"))]
    ImageNet,
}

impl ValueRange {
    /// Its name in configuration and messages.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::To255 => "0..255",
            Self::ToOne => "0..1",
            Self::ImageNet => "imagenet",
        }
    }

    /// How the values of red, green and blue are converted.
    fn conversions(self) -> [Conversion; 3] {
        match self {
            Self::To255 => [Conversion::times(1.0); 3],
            Self::ToOne => [Conversion::times(1.0 / 255.0); 3],
            // The values of torchvision's models.
            Self::ImageNet => [
                Conversion::normalising(0.485, 0.229),
                Conversion::normalising(0.456, 0.224),
                Conversion::normalising(0.406, 0.225),
            ],
        }
    }
}

/// The conversion of a colour's values: a factor, and an offset that is added afterwards.
#[derive(Clone, Copy)]
pub(crate) struct Conversion {
    pub(crate) factor: f32,
    pub(crate) offset: f32,
}

impl Conversion {
    fn times(factor: f32) -> Self {
        let offset = 0.0;
        Self { factor, offset }
    }

    /// To a mean of 0 and a deviation of 1, if values from 0 to 1 have these.
    fn normalising(mean: f32, deviation: f32) -> Self {
        Self {
            factor: 1.0 / (255.0 * deviation),
            offset: -mean / deviation,
        }
    }

    fn apply(self, value: f32) -> f32 {
        value * self.factor + self.offset
    }
}

/// The position of the colours in a network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TensorLayout {
    /// Three planes, one after another: `[1, 3, rows, columns]`.
    Nchw,
    /// The three values of a pixel side by side: `[1, rows, columns, 3]`.
    Nhwc,
}

/// The type of a network's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputElement {
    /// float32, or float16 made of it.
    Float,
    /// Bytes, which are pixel values from 0 to 255.
    Byte,
}

/// The input that a network expects: one picture of `size`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputFormat {
    /// Columns and rows of a plane; the largest, for a network with open sides.
    pub size: PictureSize,
    /// The way the picture is fitted.
    pub fit: Fit,
    /// The order of the planes.
    pub color_order: ColorOrder,
    /// The range of the values.
    pub value_range: ValueRange,
    /// The position of the colours.
    pub layout: TensorLayout,
    /// The type of the numbers.
    pub element: InputElement,
}

impl InputFormat {
    /// The same picture as pixels: bytes of red, green and blue, side by side.
    pub(crate) fn as_pixels(self) -> Self {
        Self {
            color_order: ColorOrder::Rgb,
            value_range: ValueRange::To255,
            layout: TensorLayout::Nhwc,
            element: InputElement::Byte,
            ..self
        }
    }

    /// The shape of the input.
    pub fn shape(&self) -> [i64; 4] {
        self.shape_of(self.size)
    }

    /// The shape of an input of `size`.
    pub(crate) fn shape_of(&self, size: PictureSize) -> [i64; 4] {
        let rows = i64::from(size.height);
        let columns = i64::from(size.width);
        match self.layout {
            TensorLayout::Nchw => [1, 3, rows, columns],
            TensorLayout::Nhwc => [1, rows, columns, 3],
        }
    }

    /// The size of a picture of `source` in the input, without margins: a decoder that scales need not deliver more.
    pub(crate) fn fitted(&self, source: PictureSize) -> PictureSize {
        let (placement, _) = place(source, *self, self.size);
        PictureSize::new(placement.width, placement.height)
    }

    /// The smallest input of whole strides that holds a picture of `source` as large as the largest input does, with no
    /// side below `least`.
    pub(crate) fn smallest_for(
        &self,
        source: PictureSize,
        stride: u32,
        least: PictureSize,
    ) -> PictureSize {
        let (_, mapping) = place(source, *self, self.size);
        let side = |used: f64, least: u32, most: u32| {
            // An error of the scale in the last bit is not a pixel.
            let strides = (used.max(f64::from(least)) / f64::from(stride) - 1e-6).ceil();
            (strides as u32).max(1).saturating_mul(stride).min(most)
        };
        PictureSize::new(
            side(mapping.width, least.width, self.size.width),
            side(mapping.height, least.height, self.size.height),
        )
    }

    /// The share of an input of `size` that a picture of `source` does not cover, 0 to 1.
    pub fn padding(&self, source: PictureSize, size: PictureSize) -> f64 {
        let covered = self.fitted(source).pixels() as f64;
        1.0 - covered / (size.pixels() as f64).max(1.0)
    }

    /// Cuts the input of `size` out of `largest`, the largest input filled with a picture of `source`; also returns its
    /// mapping.
    pub(crate) fn cut(
        &self,
        largest: &InputTensor,
        source: PictureSize,
        size: PictureSize,
    ) -> (InputTensor, InputMapping) {
        match largest {
            InputTensor::Floats(values) => {
                let (cut, mapping) = self.cut_values(values, source, size);
                (InputTensor::Floats(cut), mapping)
            }
            InputTensor::Bytes(values) => {
                let (cut, mapping) = self.cut_values(values, source, size);
                (InputTensor::Bytes(cut), mapping)
            }
        }
    }

    fn cut_values<T: Copy>(
        &self,
        values: &[T],
        source: PictureSize,
        size: PictureSize,
    ) -> (Vec<T>, InputMapping) {
        let (from, _) = place(source, *self, self.size);
        let (to, mapping) = place(source, *self, size);
        let left = (from.left - to.left) as usize;
        let top = (from.top - to.top) as usize;
        let rows = size.height as usize;
        let columns = size.width as usize;
        let full_width = self.size.width as usize;
        // Three planes of one colour each, or one of pixels with three values.
        let (planes, pixel_values) = match self.layout {
            TensorLayout::Nchw => (3, 1),
            TensorLayout::Nhwc => (1, 3),
        };
        let plane_values = pixel_values * full_width * self.size.height as usize;
        let mut cut = Vec::with_capacity(3 * rows * columns);
        for plane in 0..planes {
            for row in 0..rows {
                let pixels_before = (top + row) * full_width + left;
                let start = plane * plane_values + pixels_before * pixel_values;
                cut.extend_from_slice(&values[start..][..columns * pixel_values]);
            }
        }
        (cut, mapping)
    }

    /// The network's colour planes in order.
    pub(crate) fn planes(&self) -> [ColorPlane; 3] {
        let conversions = self.value_range.conversions();
        let order = match self.color_order {
            ColorOrder::Rgb => [0, 1, 2],
            ColorOrder::Bgr => [2, 1, 0],
        };
        order.map(|color| ColorPlane {
            color,
            conversion: conversions[color],
        })
    }
}

/// One of a network's colour planes.
pub(crate) struct ColorPlane {
    /// The index of its colour in red, green, blue.
    pub(crate) color: usize,
    pub(crate) conversion: Conversion,
}

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

    /// The numbers as float32; bytes keep their values.
    pub fn to_floats(&self) -> Cow<'_, [f32]> {
        match self {
            Self::Floats(values) => Cow::Borrowed(values),
            Self::Bytes(values) => values.iter().copied().map(f32::from).collect(),
        }
    }
}

/// A number of an input.
trait Number: Copy {
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

/// The mapping from the input's pixels back to normalised coordinates of the source picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputMapping {
    /// Input column of the picture's left edge.
    offset_x: f64,
    /// Input row of the picture's top edge.
    offset_y: f64,
    /// Input columns of the whole picture.
    width: f64,
    /// Input rows of the whole picture.
    height: f64,
}

impl InputMapping {
    /// The box with these corners in input pixels, in normalised coordinates of the source picture; not
    /// clipped.
    pub(crate) fn to_source(self, corners: Corners) -> BoundingBox {
        let x1 = (corners.x1 - self.offset_x) / self.width;
        let y1 = (corners.y1 - self.offset_y) / self.height;
        let x2 = (corners.x2 - self.offset_x) / self.width;
        let y2 = (corners.y2 - self.offset_y) / self.height;
        BoundingBox::new((x1 + x2) / 2.0, (y1 + y2) / 2.0, x2 - x1, y2 - y1)
    }
}

/// The position of the resized picture in the input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Placement {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
}

/// Fills one network's input, reusing its buffers from picture to picture.
#[derive(Clone)]
pub struct Letterbox {
    format: InputFormat,
    /// Columns and rows of the input, at most those of the format.
    size: PictureSize,
    resizer: Resizer,
    resized: Vec<u8>,
    tensor: InputTensor,
    /// The placement for which the tensor's margin is filled.
    filled: Option<Placement>,
}

impl Letterbox {
    /// Creates a letterbox for a network with this input.
    pub fn new(format: InputFormat) -> Self {
        Self::of_size(format, format.size)
    }

    /// Creates a letterbox for an input of `size`, at most that of the format.
    pub(crate) fn of_size(format: InputFormat, size: PictureSize) -> Self {
        Self {
            format,
            size,
            resizer: Resizer::new(),
            resized: Vec::new(),
            tensor: InputTensor::zeros(format.element, size),
            filled: None,
        }
    }

    /// Columns and rows of the input.
    pub(crate) fn size(&self) -> PictureSize {
        self.size
    }

    /// The input, in the shape of the format, with the content of the last [`fill`](Self::fill).
    pub fn tensor(&self) -> &InputTensor {
        &self.tensor
    }

    /// Turns `picture`, which is RGB, into the input and returns the mapping back. Bilinear without antialiasing, as in
    /// the training of the networks (OpenCV's `INTER_LINEAR`).
    ///
    /// # Errors
    /// If the picture is empty, or is not RGB of its size.
    pub fn fill(&mut self, picture: &Picture) -> Result<InputMapping, FrameFault> {
        check(picture)?;
        // Uses the size before the decoder scaled it, so that scaling moves nothing.
        let (placement, mapping) = place(picture.source_size, self.format, self.size);
        if self.filled != Some(placement) {
            match &mut self.tensor {
                InputTensor::Floats(values) => fill_margin(&self.format, values),
                InputTensor::Bytes(values) => fill_margin(&self.format, values),
            }
            self.filled = Some(placement);
        }
        let fits = picture.size == PictureSize::new(placement.width, placement.height);
        let pixels = if fits {
            &picture.pixels
        } else {
            self.resize(picture, placement).map_err(|error| {
                FrameFault::undecodable(format!("the picture could not be resized: {error}"))
            })?;
            &self.resized
        };
        match &mut self.tensor {
            InputTensor::Floats(values) => {
                put(&self.format, self.size, placement, pixels, values);
            }
            InputTensor::Bytes(values) if self.format == self.format.as_pixels() => {
                copy_rows(self.size, placement, pixels, values);
            }
            InputTensor::Bytes(values) => put(&self.format, self.size, placement, pixels, values),
        }
        Ok(mapping)
    }

    fn resize(&mut self, picture: &Picture, placement: Placement) -> Result<(), Box<dyn Error>> {
        let pixels = placement.width as usize * placement.height as usize;
        self.resized.resize(pixels * 3, 0);
        let PictureSize { width, height } = picture.size;
        // The type of a pixel is known here, so that only its code is compiled.
        let source = TypedImageRef::<U8x3>::from_buffer(width, height, &picture.pixels)?;
        let Placement { width, height, .. } = placement;
        let mut target = TypedImage::<U8x3>::from_buffer(width, height, &mut self.resized)?;
        // A kernel of fixed size: a convolution would widen it when shrinking, which is antialiasing.
        let options =
            ResizeOptions::new().resize_alg(ResizeAlg::Interpolation(FilterType::Bilinear));
        Ok(self.resizer.resize_typed(&source, &mut target, &options)?)
    }
}

/// Sets every pixel to the margin's value.
fn fill_margin<T: Number>(format: &InputFormat, tensor: &mut [T]) {
    let values = format.planes().map(|plane| T::of(MARGIN, plane.conversion));
    match format.layout {
        TensorLayout::Nchw => {
            let plane_values = tensor.len() / 3;
            let planes = tensor.chunks_exact_mut(plane_values.max(1));
            for (plane, value) in planes.zip(values) {
                plane.fill(value);
            }
        }
        TensorLayout::Nhwc => {
            for pixel in tensor.chunks_exact_mut(3) {
                pixel.copy_from_slice(&values);
            }
        }
    }
}

/// Copies pixels to their place in an input of pixels.
fn copy_rows(size: PictureSize, placement: Placement, pixels: &[u8], tensor: &mut [u8]) {
    let columns = size.width as usize;
    let length = placement.width as usize * 3;
    for (row, pixels) in pixels.chunks_exact(length).enumerate() {
        let start = ((placement.top as usize + row) * columns + placement.left as usize) * 3;
        tensor[start..][..length].copy_from_slice(pixels);
    }
}

/// Puts pixels in their place, converted.
fn put<T: Number>(
    format: &InputFormat,
    size: PictureSize,
    placement: Placement,
    pixels: &[u8],
    tensor: &mut [T],
) {
    let convert = match format.layout {
        TensorLayout::Nchw => convert::<1, T>,
        TensorLayout::Nhwc => convert::<3, T>,
    };
    convert(format, size, placement, pixels, tensor);
}

/// Converts interleaved bytes. `STEP` is the distance between two values of one colour in the tensor: 1 if each colour has
/// a plane, 3 if colours are interleaved.
fn convert<const STEP: usize, T: Number>(
    format: &InputFormat,
    size: PictureSize,
    placement: Placement,
    pixels: &[u8],
    tensor: &mut [T],
) {
    let columns = size.width as usize;
    let width = placement.width as usize;
    let left = placement.left as usize;
    // The distance between two colours of one pixel: a whole plane, or the next value.
    let color_distance = match STEP {
        1 => columns * size.height as usize,
        _ => 1,
    };
    let planes = format.planes();
    for (row, pixels) in pixels.chunks_exact(width * 3).enumerate() {
        let start = ((placement.top as usize + row) * columns + left) * STEP;
        for (index, plane) in planes.iter().enumerate() {
            let targets = tensor[index * color_distance + start..].chunks_mut(STEP);
            for (target, pixel) in targets.zip(pixels.chunks_exact(3)) {
                target[0] = T::of(pixel[plane.color], plane.conversion);
            }
        }
    }
}

fn check(picture: &Picture) -> Result<(), FrameFault> {
    for size in [picture.size, picture.source_size] {
        if size.pixels() == 0 {
            return Err(FrameFault::undecodable(format!(
                "the picture is empty ({size})"
            )));
        }
    }
    let expected = picture.size.pixels().saturating_mul(3);
    if expected != picture.pixels.len() as u64 {
        let size = picture.size;
        let actual = picture.pixels.len();
        return Err(FrameFault::undecodable(format!(
            "an RGB picture of {size} needs {expected} bytes and has {actual}"
        )));
    }
    Ok(())
}

/// Returns the position of a picture of `source` in an input of `size`, and the mapping back. The picture is as large as
/// in the largest input, so that its pixels are the same in all.
fn place(source: PictureSize, format: InputFormat, size: PictureSize) -> (Placement, InputMapping) {
    let input = format.size;
    let width = f64::from(source.width);
    let height = f64::from(source.height);
    let columns = f64::from(input.width);
    let rows = f64::from(input.height);
    let scale = (columns / width).min(rows / height);
    let (scaled_width, scaled_height) = match format.fit {
        Fit::Stretch => (columns, rows),
        Fit::TopLeft | Fit::Centre => (scale * width, scale * height),
    };
    // Ultralytics rounds. YOLOX truncates, even 415.999…, the result for 720 columns at a scale of 416/720: one column
    // less moves boxes by up to 3 pixels and scores by 0.02, so truncation is kept.
    let whole = |value: f64, most: u32| {
        let value = match format.fit {
            Fit::Centre => value.round(),
            Fit::TopLeft | Fit::Stretch => value.floor(),
        };
        (value as u32).clamp(1, most)
    };
    let used_width = whole(scaled_width, input.width);
    let used_height = whole(scaled_height, input.height);
    // An odd margin has its larger part at the right and bottom, as in Ultralytics.
    let (left, top) = match format.fit {
        Fit::Centre => (
            size.width.saturating_sub(used_width) / 2,
            size.height.saturating_sub(used_height) / 2,
        ),
        Fit::TopLeft | Fit::Stretch => (0, 0),
    };
    let placement = Placement {
        left,
        top,
        width: used_width,
        height: used_height,
    };
    let mapping = InputMapping {
        offset_x: f64::from(left),
        offset_y: f64::from(top),
        width: scaled_width,
        height: scaled_height,
    };
    (placement, mapping)
}

#[cfg(test)]
mod tests;
