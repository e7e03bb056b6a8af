//! From a decoded picture to the input tensor of a network, and the way back for what the network finds.

use super::{Picture, PixelLayout};
use crate::geometry::{BoundingBox, Corners, PictureSize};
use fast_image_resize::images::{Image, ImageRef};
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer};
use serde::{Deserialize, Serialize};

/// Order of the colour planes a network expects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ColorOrder {
    /// Red, green, blue.
    Rgb,
    /// Blue, green, red.
    Bgr,
}

/// How a picture is made to fit the network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// Aspect kept, in the top-left corner, the rest filled with grey of this value (YOLOX: 114).
    TopLeft(u8),
    /// Aspect kept, in the middle, the rest filled with grey of this value (Ultralytics: 114).
    Centre(u8),
    /// Both sides stretched to the input's.
    Stretch,
}

/// What a pixel value of 255 becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueRange {
    /// 255: values as they are.
    To255,
    /// 1: values divided by 255.
    ToOne,
}

/// The input a network expects: three planes of `size`, float32, one after the other (CHW).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputFormat {
    /// Columns and rows of a plane.
    pub size: PictureSize,
    /// How the picture is made to fit.
    pub fit: Fit,
    /// Order of the planes.
    pub color_order: ColorOrder,
    /// Range of the values.
    pub value_range: ValueRange,
}

/// The way back from the input's pixels to normalised coordinates of the source picture.
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
    pub fn to_source(&self, corners: Corners) -> BoundingBox {
        let x1 = (corners.x1 - self.offset_x) / self.width;
        let y1 = (corners.y1 - self.offset_y) / self.height;
        let x2 = (corners.x2 - self.offset_x) / self.width;
        let y2 = (corners.y2 - self.offset_y) / self.height;
        BoundingBox::new((x1 + x2) / 2.0, (y1 + y2) / 2.0, x2 - x1, y2 - y1)
    }
}

/// Why a picture cannot become an input tensor.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LetterboxError {
    /// The picture has no pixels.
    #[error("the picture is empty ({0})")]
    Empty(PictureSize),
    /// The buffer does not have the bytes its size and layout say.
    #[error("a {size} picture needs {expected} bytes and has {actual}")]
    WrongLength {
        /// Size of the picture.
        size: PictureSize,
        /// Bytes it should have.
        expected: u64,
        /// Bytes it has.
        actual: usize,
    },
    /// The resizer refused.
    #[error("the picture could not be resized: {0}")]
    Resize(String),
}

/// Where the resized picture lies in the input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Placement {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
}

/// Fills one network's input, keeping its buffers from picture to picture.
pub struct Letterbox {
    format: InputFormat,
    resizer: Resizer,
    resized: Vec<u8>,
    tensor: Vec<f32>,
    /// What the tensor's margin is filled for.
    filled: Option<Placement>,
}

impl Letterbox {
    /// For a network with that input.
    pub fn new(format: InputFormat) -> Self {
        let plane = format.size.width as usize * format.size.height as usize;
        Self {
            format,
            resizer: Resizer::new(),
            resized: Vec::new(),
            tensor: vec![0.0; 3 * plane],
            filled: None,
        }
    }

    /// The input: three planes of float32. Its content is that of the last [`fill`](Self::fill).
    pub fn tensor(&self) -> &[f32] {
        &self.tensor
    }

    /// Turns `picture` into the input and says how to come back. Bilinear without antialiasing, as the
    /// networks were trained with (OpenCV's `INTER_LINEAR`).
    ///
    /// # Errors
    /// When the picture is empty or its buffer does not fit its size.
    pub fn fill(&mut self, picture: &Picture) -> Result<InputMapping, LetterboxError> {
        check(picture)?;
        let (placement, mapping) = place(picture.size, self.format);
        if self.filled != Some(placement) {
            let margin = self.margin();
            self.tensor.fill(margin);
            self.filled = Some(placement);
        }
        self.resize(picture, placement)?;
        match picture.layout {
            PixelLayout::Rgb8 => self.spread::<3>(placement),
            PixelLayout::Gray8 => self.spread::<1>(placement),
        }
        Ok(mapping)
    }

    fn margin(&self) -> f32 {
        let fill = match self.format.fit {
            Fit::TopLeft(fill) | Fit::Centre(fill) => fill,
            Fit::Stretch => 0,
        };
        f32::from(fill) * self.factor()
    }

    fn factor(&self) -> f32 {
        match self.format.value_range {
            ValueRange::To255 => 1.0,
            ValueRange::ToOne => 1.0 / 255.0,
        }
    }

    fn resize(&mut self, picture: &Picture, placement: Placement) -> Result<(), LetterboxError> {
        let refused = |reason: String| LetterboxError::Resize(reason);
        let pixel_type = match picture.layout {
            PixelLayout::Rgb8 => PixelType::U8x3,
            PixelLayout::Gray8 => PixelType::U8,
        };
        let PictureSize { width, height } = picture.size;
        let source = ImageRef::new(width, height, &picture.pixels, pixel_type)
            .map_err(|error| refused(error.to_string()))?;
        let bytes = placement.width as usize * placement.height as usize;
        self.resized.resize(bytes * picture.layout.channels(), 0);
        let mut target = Image::from_slice_u8(
            placement.width,
            placement.height,
            &mut self.resized,
            pixel_type,
        )
        .map_err(|error| refused(error.to_string()))?;
        // A kernel of fixed size: a convolution would widen it when shrinking, which is antialiasing.
        let options =
            ResizeOptions::new().resize_alg(ResizeAlg::Interpolation(FilterType::Bilinear));
        self.resizer
            .resize(&source, &mut target, &options)
            .map_err(|error| refused(error.to_string()))
    }

    /// From interleaved bytes to planes of float32, in one pass.
    fn spread<const CHANNELS: usize>(&mut self, placement: Placement) {
        let factor = self.factor();
        let columns = self.format.size.width as usize;
        let plane = columns * self.format.size.height as usize;
        let (width, left) = (placement.width as usize, placement.left as usize);
        let (first, rest) = self.tensor.split_at_mut(plane);
        let (second, third) = rest.split_at_mut(plane);
        let (red, green, blue) = match self.format.color_order {
            ColorOrder::Rgb => (first, second, third),
            ColorOrder::Bgr => (third, second, first),
        };
        for (row, pixels) in self.resized.chunks_exact(width * CHANNELS).enumerate() {
            let start = (placement.top as usize + row) * columns + left;
            let red = &mut red[start..start + width];
            let green = &mut green[start..start + width];
            let blue = &mut blue[start..start + width];
            let targets = red.iter_mut().zip(green).zip(blue);
            for (((red, green), blue), pixel) in targets.zip(pixels.chunks_exact(CHANNELS)) {
                *red = f32::from(pixel[0]) * factor;
                *green = f32::from(pixel[CHANNELS / 2]) * factor;
                *blue = f32::from(pixel[CHANNELS - 1]) * factor;
            }
        }
    }
}

fn check(picture: &Picture) -> Result<(), LetterboxError> {
    if picture.size.pixels() == 0 {
        return Err(LetterboxError::Empty(picture.size));
    }
    let expected = picture
        .size
        .pixels()
        .saturating_mul(picture.layout.channels() as u64);
    if expected != picture.pixels.len() as u64 {
        return Err(LetterboxError::WrongLength {
            size: picture.size,
            expected,
            actual: picture.pixels.len(),
        });
    }
    Ok(())
}

/// Where a picture of `size` goes in the input.
fn place(size: PictureSize, format: InputFormat) -> (Placement, InputMapping) {
    let input = format.size;
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let (columns, rows) = (f64::from(input.width), f64::from(input.height));
    if format.fit == Fit::Stretch {
        let placement = Placement {
            left: 0,
            top: 0,
            width: input.width,
            height: input.height,
        };
        let mapping = InputMapping {
            offset_x: 0.0,
            offset_y: 0.0,
            width: columns,
            height: rows,
        };
        return (placement, mapping);
    }
    let scale = (columns / width).min(rows / height);
    let (scaled_width, scaled_height) = (scale * width, scale * height);
    // Ultralytics rounds. YOLOX cuts the fraction off, of 415.999… too, which is what 720 columns at a scale
    // of 416/720 come to: one column less moves boxes by up to 3 pixels and scores by 0.02, so it is kept.
    let whole = |value: f64, most: u32| {
        let value = match format.fit {
            Fit::Centre(_) => value.round(),
            Fit::TopLeft(_) | Fit::Stretch => value.floor(),
        };
        (value as u32).clamp(1, most)
    };
    let (used_width, used_height) = (
        whole(scaled_width, input.width),
        whole(scaled_height, input.height),
    );
    // An odd margin has its larger part at the right and bottom, as Ultralytics has it.
    let (left, top) = match format.fit {
        Fit::Centre(_) => (
            (input.width - used_width) / 2,
            (input.height - used_height) / 2,
        ),
        Fit::TopLeft(_) | Fit::Stretch => (0, 0),
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
#[path = "letterbox_tests.rs"]
mod tests;
