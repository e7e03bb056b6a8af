//! The input that a network expects: its size, the place of a picture in it, and the conversion of pixel values.

use albireo_core::geometry::{BoundingBox, Corners, PictureSize};
use serde::{Deserialize, Serialize};

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

    pub(super) fn apply(self, value: f32) -> f32 {
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
        let side = |used: f64, shortest: u32, longest: u32| {
            let strides = used.max(f64::from(shortest)) / f64::from(stride);
            // An error of the scale in the last bit is not a pixel.
            let whole_strides = (strides - 1e-6).ceil() as u32;
            whole_strides.max(1).saturating_mul(stride).min(longest)
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

/// The mapping from the input's pixels back to normalised coordinates of the source picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputMapping {
    /// Input column of the picture's left edge.
    offset_x: f64,
    /// Input row of the picture's top edge.
    offset_y: f64,
    /// Input columns of the whole picture.
    pub(super) width: f64,
    /// Input rows of the whole picture.
    pub(super) height: f64,
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

    /// The corners in input pixels of a box in normalised coordinates of the source picture.
    pub(crate) fn to_input(self, bounding_box: BoundingBox) -> Corners {
        let Corners { x1, y1, x2, y2 } = bounding_box.corners();
        Corners {
            x1: x1 * self.width + self.offset_x,
            y1: y1 * self.height + self.offset_y,
            x2: x2 * self.width + self.offset_x,
            y2: y2 * self.height + self.offset_y,
        }
    }
}

/// The position of the resized picture in the input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Placement {
    pub(super) left: u32,
    pub(super) top: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

/// Returns the position of a picture of `source` in an input of `size`, and the mapping back. The picture is as large as
/// in the largest input, so that its pixels are the same in all.
pub(super) fn place(
    source: PictureSize,
    format: InputFormat,
    size: PictureSize,
) -> (Placement, InputMapping) {
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
        let rounded = match format.fit {
            Fit::Centre => value.round(),
            Fit::TopLeft | Fit::Stretch => value.floor(),
        };
        (rounded as u32).clamp(1, most)
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
