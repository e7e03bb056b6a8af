//! Decodes PNG files with `png`: every colour type and depth, interlaced or not.

use super::decode::make_room;
use super::limits::decoded_bytes;
use super::{EncodedPicture, FrameFault, FrameLimits, PixelLayout, decode_raw};
use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Transformations};
use std::io::Cursor;

/// Decodes into `pixels`, which has the length for `picture.size` and `layout`.
pub(super) fn decode(
    picture: &EncodedPicture,
    limits: &FrameLimits,
    layout: PixelLayout,
    pixels: &mut [u8],
) -> Result<(), FrameFault> {
    let memory = Limits {
        // A pixel of the richest kind has four samples of 16 bits.
        bytes: usize::try_from(limits.max_pixels.saturating_mul(8)).unwrap_or(usize::MAX),
    };
    let mut decoder = Decoder::new_with_limits(Cursor::new(picture.bytes.as_ref()), memory);
    // Palettes become colours. Text and colour profiles are ignored.
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let mut reader = decoder.read_info().map_err(fault)?;
    let (color, depth) = reader.output_color_type();
    let info = reader.info();
    if (info.width, info.height) != (picture.size.width, picture.size.height) {
        return Err(FrameFault::undecodable(format!(
            "the PNG file contradicts its header, which says {}",
            picture.size
        )));
    }
    let channels = match color {
        ColorType::Grayscale => 1,
        ColorType::GrayscaleAlpha => 2,
        ColorType::Rgb => 3,
        ColorType::Rgba => 4,
        ColorType::Indexed => {
            return Err(FrameFault::undecodable("the PNG file has no palette"));
        }
    };
    let is_wide = depth == BitDepth::Sixteen;
    let bytes_per_sample = if is_wide { 2 } else { 1 };
    let length = decoded_bytes(picture.size, channels * bytes_per_sample, limits)?;
    if reader.output_buffer_size() != Some(length) {
        return Err(FrameFault::undecodable(format!(
            "the rows of the PNG file do not make a picture of {}",
            picture.size
        )));
    }
    let has_channels_of_layout = matches!(
        (color, layout),
        (ColorType::Rgb, PixelLayout::Rgb8) | (ColorType::Grayscale, PixelLayout::Gray8)
    );
    if has_channels_of_layout && !is_wide {
        reader.next_frame(pixels).map_err(fault)?;
        return Ok(());
    }
    let mut samples = Vec::new();
    make_room(&mut samples, length)?;
    reader.next_frame(&mut samples).map_err(fault)?;
    if is_wide {
        samples = decode_raw::upper_bits(&samples, u16::from_be_bytes);
    }
    match (color, layout) {
        (ColorType::Grayscale, PixelLayout::Rgb8) => decode_raw::grey_to_rgb::<1>(&samples, pixels),
        (ColorType::Grayscale, PixelLayout::Gray8) => pixels.copy_from_slice(&samples),
        (ColorType::GrayscaleAlpha, PixelLayout::Rgb8) => {
            decode_raw::grey_to_rgb::<2>(&samples, pixels);
        }
        (ColorType::GrayscaleAlpha, PixelLayout::Gray8) => {
            let (pairs, _) = samples.as_chunks::<2>();
            for (to, [grey, _alpha]) in pixels.iter_mut().zip(pairs) {
                *to = *grey;
            }
        }
        (ColorType::Rgba, _) => decode_raw::colours::<4>(&samples, [0, 1, 2], layout, pixels),
        (ColorType::Rgb | ColorType::Indexed, _) => {
            decode_raw::colours::<3>(&samples, [0, 1, 2], layout, pixels)
        }
    }
    Ok(())
}

fn fault(error: DecodingError) -> FrameFault {
    match error {
        DecodingError::LimitsExceeded => FrameFault::oversized(
            "decoding the PNG file would take more memory than a decoded picture may have",
        ),
        other => FrameFault::undecodable(format!("the PNG file is broken: {other}")),
    }
}
