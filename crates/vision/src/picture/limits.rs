//! The checks made before memory is allocated.

use super::FrameFault;
use albireo_core::geometry::PictureSize;
use serde::{Deserialize, Serialize};

/// Limits checked before memory is allocated for a frame: the `[frame]` section.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameLimits {
    /// The maximum size of a payload, in bytes.
    pub max_payload_bytes: usize,
    /// The maximum number of pixels of a picture, columns times rows. Decoded, each takes three bytes, and while a PNG file
    /// is decoded up to eight more.
    pub max_pixels: u64,
}

impl Default for FrameLimits {
    fn default() -> Self {
        Self {
            max_payload_bytes: 16 << 20,
            max_pixels: 7680 * 4320,
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

/// Checks a picture's size.
///
/// # Errors
/// If it exceeds a limit.
pub fn check_picture(size: PictureSize, limits: &FrameLimits) -> Result<(), FrameFault> {
    if size.width == 0 || size.height == 0 {
        return Err(FrameFault::undecodable(format!(
            "a picture of {size} has no pixels"
        )));
    }
    if size.pixels() > limits.max_pixels {
        return Err(FrameFault::oversized(format!(
            "the picture is {size}, {} pixels; frame.max_pixels allows {}",
            size.pixels(),
            limits.max_pixels
        )));
    }
    Ok(())
}

/// The number of bytes of a picture of `size` with `bytes_per_pixel`, if it is within the limit.
pub(super) fn decoded_bytes(
    size: PictureSize,
    bytes_per_pixel: usize,
    limits: &FrameLimits,
) -> Result<usize, FrameFault> {
    check_picture(size, limits)?;
    size.pixels()
        .checked_mul(bytes_per_pixel as u64)
        .and_then(|bytes| usize::try_from(bytes).ok())
        .ok_or_else(|| {
            FrameFault::oversized(format!("the picture is {size}, more than memory holds"))
        })
}
