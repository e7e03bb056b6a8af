//! Decodes JPEG files at a half, a quarter or an eighth of their size with libjpeg-turbo, whose inverse transform makes
//! the smaller picture directly.

use super::header::check_jpeg_is_whole;
use super::{EncodedPicture, FrameFault, MAX_SCANS, Picture, PixelLayout};
use albireo_core::geometry::PictureSize;
use turbojpeg::{Colorspace, Decompressor, Image, PixelFormat, ScalingFactor};

/// A scale and the resulting size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    factor: ScalingFactor,
    size: PictureSize,
}

impl Scale {
    /// The smallest scale at which a picture of size `source` is not smaller than `target`; `None` if that is its full
    /// size.
    pub(super) fn towards(target: PictureSize, source: PictureSize) -> Option<Self> {
        let smallest_first = [
            ScalingFactor::ONE_EIGHTH,
            ScalingFactor::ONE_QUARTER,
            ScalingFactor::ONE_HALF,
        ];
        for factor in smallest_first {
            let size = scaled(source, factor);
            if size.width >= target.width && size.height >= target.height {
                return Some(Self { factor, size });
            }
        }
        None
    }
}

fn scaled(size: PictureSize, factor: ScalingFactor) -> PictureSize {
    let side = |pixels: u32| u32::try_from(factor.scale(pixels as usize)).unwrap_or(pixels);
    PictureSize::new(side(size.width), side(size.height))
}

/// Decodes `picture` at `scale`; returns `false` for files of a kind that is not decoded here (CMYK, arithmetic coding,
/// lossless).
///
/// # Errors
/// [`FrameFault`] if the file is broken.
pub(super) fn decode(
    picture: &EncodedPicture,
    scale: Scale,
    layout: PixelLayout,
    into: &mut Picture,
) -> Result<bool, FrameFault> {
    check_jpeg_is_whole(&picture.bytes)?;
    let broken = |error: turbojpeg::Error| {
        FrameFault::undecodable(format!("the JPEG file is broken: {error}"))
    };
    let mut decompressor = Decompressor::new().map_err(broken)?;
    let header = decompressor.read_header(&picture.bytes).map_err(broken)?;
    let is_usual = matches!(
        header.colorspace,
        Colorspace::YCbCr | Colorspace::RGB | Colorspace::Gray
    );
    if !is_usual || header.is_arithmetic || header.is_lossless {
        return Ok(false);
    }
    if (header.width, header.height) != (picture.size.width as usize, picture.size.height as usize)
    {
        return Err(FrameFault::undecodable(format!(
            "the JPEG file contradicts its header, which says {}",
            picture.size
        )));
    }
    let Scale { factor, size } = scale;
    decompressor.set_scaling_factor(factor).map_err(broken)?;
    decompressor.set_scan_limit(MAX_SCANS).map_err(broken)?;
    let width = size.width as usize;
    let height = size.height as usize;
    into.size = size;
    into.source_size = picture.size;
    into.layout = layout;
    into.pixels.resize(width * height * layout.channels(), 0);
    let format = match layout {
        PixelLayout::Rgb8 => PixelFormat::RGB,
        PixelLayout::Gray8 => PixelFormat::GRAY,
    };
    let output = Image {
        pixels: into.pixels.as_mut_slice(),
        width,
        pitch: width * layout.channels(),
        height,
        format,
    };
    // A warning, such as of missing data that was filled with grey, is an error here too.
    decompressor.decompress(&picture.bytes, output).map_err(broken)?;
    Ok(true)
}

#[cfg(test)]
mod tests;
