//! Turns a decoded picture into the input tensor of a network.

use super::input_format::{InputFormat, InputMapping, Placement, TensorLayout, place};
use super::input_tensor::{InputTensor, Number};
use super::{FrameFault, Picture};
use albireo_core::geometry::PictureSize;
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use std::error::Error;

/// The grey of the margin, the same for YOLOX and Ultralytics.
const MARGIN: u8 = 114;

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

#[cfg(test)]
mod tests;
