//! The checks made before memory is allocated.

use super::{FrameFault, PictureFormat, PixelLayout};
use albireo_core::geometry::PictureSize;
use serde::{Deserialize, Serialize};

/// Limits checked before memory is allocated for a frame: the `[frame]` section.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameLimits {
    /// The maximum size of a payload, in bytes.
    pub max_payload_bytes: usize,
    /// The maximum number of columns of a picture.
    #[serde(skip)]
    pub max_width: u32,
    /// The maximum number of rows of a picture.
    #[serde(skip)]
    pub max_height: u32,
    /// The maximum size of a decoded picture, in bytes.
    #[serde(skip)]
    pub max_decoded_bytes: usize,
}

impl Default for FrameLimits {
    fn default() -> Self {
        Self {
            max_payload_bytes: 16 << 20,
            max_width: 7680,
            max_height: 4320,
            max_decoded_bytes: 128 << 20,
        }
    }
}

/// Checks the length of a payload.
///
/// # Errors
/// If it is empty or too long.
pub fn check_payload(bytes: usize, limits: &FrameLimits) -> Result<(), FrameFault> {
    if bytes == 0 {
        return Err(FrameFault::undecodable("the payload is empty"));
    }
    if bytes > limits.max_payload_bytes {
        return Err(FrameFault::oversized(format!(
            "the payload has {bytes} bytes; frame.max_payload_bytes allows {}",
            limits.max_payload_bytes
        )));
    }
    Ok(())
}

/// Checks a picture's size, and that it fits `max_decoded_bytes` when decoded to RGB.
///
/// # Errors
/// If it exceeds a limit.
pub fn check_picture(size: PictureSize, limits: &FrameLimits) -> Result<(), FrameFault> {
    if size.width == 0 || size.height == 0 {
        return Err(FrameFault::undecodable(format!(
            "a picture of {size} has no pixels"
        )));
    }
    if size.width > limits.max_width || size.height > limits.max_height {
        return Err(FrameFault::oversized(format!(
            "the picture is {size}; at most {}x{} is accepted",
            limits.max_width, limits.max_height
        )));
    }
    decoded_bytes(size, PixelLayout::Rgb8.channels(), limits).map(|_| ())
}

/// The number of bytes of a picture of `size` with `bytes_per_pixel`, if within `max_decoded_bytes`.
pub(super) fn decoded_bytes(
    size: PictureSize,
    bytes_per_pixel: usize,
    limits: &FrameLimits,
) -> Result<usize, FrameFault> {
    size.pixels()
        .checked_mul(bytes_per_pixel as u64)
        .and_then(|bytes| usize::try_from(bytes).ok())
        .filter(|bytes| *bytes <= limits.max_decoded_bytes)
        .ok_or_else(|| {
            FrameFault::oversized(format!(
                "the picture is {size}; decoded, it would exceed the limit of {} bytes",
                limits.max_decoded_bytes
            ))
        })
}

/// Checks that a raw picture has exactly the number of bytes that its size requires.
///
/// # Errors
/// If it has another number.
pub fn check_raw_length(
    format: PictureFormat,
    size: PictureSize,
    bytes: usize,
) -> Result<(), FrameFault> {
    match format.raw_bytes(size) {
        Some(expected) if expected == bytes as u64 => Ok(()),
        Some(expected) => Err(FrameFault::undecodable(format!(
            "a raw {} picture of {size} must have {expected} bytes, not {bytes}",
            format.as_str()
        ))),
        None => Err(FrameFault::oversized(format!(
            "a picture of {size} is too large"
        ))),
    }
}
