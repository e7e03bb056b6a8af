//! Raw pictures as senders publish them: of one length, or with rows that are padded.

use super::limits::check_picture;
use super::{EncodedPicture, FrameFault, FrameLimits, PictureFormat};
use albireo_core::geometry::PictureSize;
use bytes::{Bytes, BytesMut};

/// The most bytes by which a row is padded. More is a picture of another size.
const MOST_PADDING: usize = 512;

/// Makes a picture of raw pixels in `format`. Rows that are padded to a multiple of four bytes, as cameras and graphics
/// cards align them, lose their padding.
///
/// # Errors
/// If it exceeds a limit, or has another number of bytes than its size requires.
pub fn raw_picture(
    format: PictureFormat,
    size: PictureSize,
    bytes: Bytes,
    limits: &FrameLimits,
) -> Result<EncodedPicture, FrameFault> {
    check_picture(size, limits)?;
    let Some(expected) = format.raw_bytes(size) else {
        return Err(FrameFault::oversized(format!(
            "a picture of {size} is too large"
        )));
    };
    let bytes = if expected == bytes.len() as u64 {
        bytes
    } else {
        without_guessed_padding(format, size, &bytes).ok_or_else(|| {
            FrameFault::undecodable(format!(
                "a raw {} picture of {size} must have {expected} bytes, not {}; rows may be padded, all alike, to a \
                 multiple of four bytes",
                format.as_str(),
                bytes.len()
            ))
        })?
    };
    Ok(EncodedPicture {
        format,
        bytes,
        size,
        mount: None,
    })
}

/// Makes a picture of raw pixels in `format` whose rows are `step` bytes apart; those of further planes in proportion.
///
/// # Errors
/// If it exceeds a limit, or if the rows do not fit in `step` or in `bytes`.
pub fn raw_picture_of_rows(
    format: PictureFormat,
    size: PictureSize,
    step: usize,
    bytes: &Bytes,
    limits: &FrameLimits,
) -> Result<EncodedPicture, FrameFault> {
    check_picture(size, limits)?;
    let planes = format.planes(size);
    // The step is that of the first plane: what it must be for the rows of each.
    let least_step = |plane: &Plane| (plane.row * PARTS).div_ceil(plane.share);
    let longest = planes.iter().map(least_step).max().unwrap_or(0);
    if step < longest {
        return Err(FrameFault::undecodable(format!(
            "a row of the {size} {} picture has {longest} bytes, but its step is {step}",
            format.as_str()
        )));
    }
    let units = planes.iter().map(|plane| plane.rows * plane.share).sum::<usize>();
    let needed = step.checked_mul(units).map(|parts| parts / PARTS);
    let packed = match needed {
        Some(needed) if needed <= bytes.len() => {
            let has_no_padding = |plane: &Plane| step * plane.share == plane.row * PARTS;
            if planes.iter().all(has_no_padding) {
                Some(bytes.slice(..needed))
            } else {
                without_padding(&planes, step, bytes)
            }
        }
        _ => None,
    };
    let Some(packed) = packed else {
        return Err(FrameFault::undecodable(format!(
            "a {} picture of {size} with rows of {step} bytes does not fit in the {} bytes that came",
            format.as_str(),
            bytes.len()
        )));
    };
    Ok(EncodedPicture {
        format,
        bytes: packed,
        size,
        mount: None,
    })
}

/// The pixels without the padding of their rows; `None` if padding does not explain the length.
fn without_guessed_padding(
    format: PictureFormat,
    size: PictureSize,
    bytes: &Bytes,
) -> Option<Bytes> {
    let planes = format.planes(size);
    let first = planes.first()?;
    // The rows of all planes are padded in proportion to the first's.
    let units = planes.iter().map(|plane| plane.rows * plane.share).sum::<usize>();
    let stride = bytes.len().checked_mul(PARTS)?.checked_div(units)?;
    let is_exact = stride.checked_mul(units)? == bytes.len() * PARTS;
    let padding = stride.checked_sub(first.row)?;
    if !is_exact || !stride.is_multiple_of(4) || padding == 0 || padding > MOST_PADDING {
        return None;
    }
    without_padding(&planes, stride, bytes)
}

/// The pixels without the padding of their rows, which are `stride` bytes apart.
fn without_padding(planes: &[Plane], stride: usize, mut rest: &[u8]) -> Option<Bytes> {
    let whole = planes.iter().map(|plane| plane.rows * plane.row).sum();
    let mut packed = BytesMut::with_capacity(whole);
    for plane in planes {
        let step = stride * plane.share / PARTS;
        for _ in 0..plane.rows {
            let (row, after) = rest.split_at_checked(step)?;
            packed.extend_from_slice(row.get(..plane.row)?);
            rest = after;
        }
    }
    Some(packed.freeze())
}

/// The parts of a row in which [`Plane::share`] counts.
const PARTS: usize = 2;

/// A plane of a raw picture.
pub(super) struct Plane {
    pub(super) rows: usize,
    /// The bytes of a row without padding.
    pub(super) row: usize,
    /// The length of its padded rows, in halves of those of the first plane.
    pub(super) share: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIX: [u8; 6] = [1, 2, 3, 4, 5, 6];

    /// The pixels of a picture of these bytes.
    fn made(format: PictureFormat, size: [u32; 2], bytes: &[u8]) -> Result<Vec<u8>, FrameFault> {
        let [width, height] = size;
        let size = PictureSize::new(width, height);
        let bytes = Bytes::copy_from_slice(bytes);
        let picture = raw_picture(format, size, bytes, &FrameLimits::default())?;
        Ok(picture.bytes.to_vec())
    }

    #[test]
    fn padding_of_rows_is_removed_and_rows_without_it_stay() {
        let padded = [1, 2, 3, 0, 4, 5, 6, 0];
        assert_eq!(made(PictureFormat::Gray8, [3, 2], &padded).unwrap(), SIX);
        assert_eq!(made(PictureFormat::Gray8, [3, 2], &SIX).unwrap(), SIX);
    }

    #[test]
    fn a_length_that_padding_does_not_explain_is_refused() {
        for length in [5, 7, 9, 10, 2000] {
            let refused = made(PictureFormat::Gray8, [3, 2], &vec![0; length]);
            let error = refused.unwrap_err().to_string();
            assert!(error.contains("must have 6 bytes"), "{error}");
        }
    }

    #[test]
    fn padding_of_further_planes_is_removed_in_proportion() {
        // Two columns of four bytes: luma, then chroma at half the size.
        let nv12 = [1, 2, 0, 0, 3, 4, 0, 0, 5, 6, 0, 0];
        assert_eq!(made(PictureFormat::Nv12, [2, 2], &nv12).unwrap(), SIX);
        let i420 = [1, 2, 0, 0, 3, 4, 0, 0, 5, 0, 6, 0];
        assert_eq!(made(PictureFormat::I420, [2, 2], &i420).unwrap(), SIX);
    }
}
