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
    let length = bytes.len();
    let packed = if expected == length as u64 {
        Some(bytes)
    } else {
        without_guessed_padding(format, size, &bytes)
    };
    let Some(packed) = packed else {
        return Err(FrameFault::undecodable(format!(
            "a raw {} picture of {size} must have {expected} bytes, not {length}; rows may be padded, all alike, to a \
             multiple of four bytes",
            format.as_str()
        )));
    };
    Ok(EncodedPicture {
        format,
        bytes: packed,
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
    let Some(packed) = packed_rows(&planes, step, bytes) else {
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

/// The pixels without the padding of their rows, which are `step` bytes apart; copied only if there is padding. `None`
/// if the rows do not fit in `bytes`.
fn packed_rows(planes: &[Plane], step: usize, bytes: &Bytes) -> Option<Bytes> {
    let units = planes.iter().map(|plane| plane.rows * plane.share).sum::<usize>();
    let needed = step.checked_mul(units)? / PARTS;
    if needed > bytes.len() {
        return None;
    }
    let has_no_padding = |plane: &Plane| step * plane.share == plane.row * PARTS;
    if planes.iter().all(has_no_padding) {
        return Some(bytes.slice(..needed));
    }
    without_padding(planes, step, bytes)
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
    let parts = bytes.len().checked_mul(PARTS)?;
    let step = parts.checked_div(units)?;
    let padding = step.checked_sub(first.row)?;
    let is_padded = (1..=MOST_PADDING).contains(&padding);
    if is_padded && parts.is_multiple_of(units) && step.is_multiple_of(4) {
        without_padding(&planes, step, bytes)
    } else {
        None
    }
}

/// The pixels without the padding of their rows, which are `step` bytes apart; `None` if the rows do not fit in `rest`.
fn without_padding(planes: &[Plane], step: usize, mut rest: &[u8]) -> Option<Bytes> {
    let whole = planes.iter().map(|plane| plane.rows * plane.row).sum();
    let mut packed = BytesMut::with_capacity(whole);
    for plane in planes {
        let step_of_plane = step * plane.share / PARTS;
        for _ in 0..plane.rows {
            let (row, after) = rest.split_at_checked(step_of_plane)?;
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
