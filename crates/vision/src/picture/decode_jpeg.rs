//! Decodes JPEG files with `zune-jpeg`.

use super::header::{check_jpeg_is_whole, with_open_end};
use super::{EncodedPicture, FrameFault, MAX_SCANS, PixelLayout, decode_raw};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// Decodes into `pixels`, which has the length for `picture.size` and `layout`.
pub(super) fn decode(
    picture: &EncodedPicture,
    layout: PixelLayout,
    pixels: &mut [u8],
) -> Result<(), FrameFault> {
    check_jpeg_is_whole(&picture.bytes)?;
    // At an end-of-image marker the decoder makes up the pixels that are still missing, so it is given none.
    match with_open_end(&picture.bytes) {
        Some(open) => decode_bytes(&open, picture, layout, pixels),
        None => decode_bytes(&picture.bytes, picture, layout, pixels),
    }
}

fn decode_bytes(
    bytes: &[u8],
    picture: &EncodedPicture,
    layout: PixelLayout,
    pixels: &mut [u8],
) -> Result<(), FrameFault> {
    let mut decoder = decoder(bytes, picture);
    decoder.decode_headers().map_err(undecodable)?;
    match (layout, decoder.input_colorspace()) {
        (PixelLayout::Rgb8, _) => {}
        (PixelLayout::Gray8, Some(ColorSpace::YCbCr | ColorSpace::Luma)) => {
            // The chroma planes are then skipped, not reconstructed.
            let options = decoder.options().jpeg_set_out_colorspace(ColorSpace::Luma);
            decoder.set_options(options);
        }
        (PixelLayout::Gray8, _) => {
            let mut colours = vec![0; pixels.len().saturating_mul(3)];
            decode_headed(decoder, picture, &mut colours)?;
            decode_raw::rgb_to_grey(&colours, pixels);
            return Ok(());
        }
    }
    decode_headed(decoder, picture, pixels)
}

fn decoder<'a>(bytes: &'a [u8], picture: &EncodedPicture) -> JpegDecoder<ZCursor<&'a [u8]>> {
    let options = DecoderOptions::default()
        // Otherwise data that cannot be decoded is filled with grey and reported as a success.
        .set_strict_mode(true)
        .set_max_width(picture.size.width as usize)
        .set_max_height(picture.size.height as usize)
        .jpeg_set_max_scans(MAX_SCANS as usize)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    JpegDecoder::new_with_options(ZCursor::new(bytes), options)
}

fn decode_headed(
    mut decoder: JpegDecoder<ZCursor<&[u8]>>,
    picture: &EncodedPicture,
    pixels: &mut [u8],
) -> Result<(), FrameFault> {
    // A file may have more than one frame header; the one checked against the limits counts.
    let expected = (picture.size.width as usize, picture.size.height as usize);
    if decoder.dimensions() != Some(expected) || decoder.output_buffer_size() != Some(pixels.len())
    {
        return Err(FrameFault::undecodable(format!(
            "the JPEG file contradicts its header, which says {}",
            picture.size
        )));
    }
    decoder.decode_into(pixels).map_err(|error| {
        FrameFault::undecodable(format!(
            "the JPEG file is broken, or its pixels are cut short: {error}"
        ))
    })
}

fn undecodable(error: zune_jpeg::errors::DecodeErrors) -> FrameFault {
    FrameFault::undecodable(format!("the JPEG file is broken: {error}"))
}
