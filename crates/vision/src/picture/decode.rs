//! Decodes a picture to pixels.

#[cfg(feature = "turbojpeg")]
use super::decode_jpeg_scaled;
use super::limits::{check_payload, check_picture, decoded_bytes};
use super::orientation::{Part, orientation};
use super::{
    EncodedPicture, FrameFault, FrameLimits, Picture, PictureFormat, PixelLayout, decode_jpeg,
    decode_png, decode_raw, raw_picture,
};
use albireo_core::geometry::PictureSize;
use bytes::Bytes;

/// The quality of JPEG files made for viewing.
const JPEG_QUALITY: u8 = 85;

/// Decodes `picture` into `into`, whose buffer is reused.
///
/// `target`: the size to which the picture will be scaled next. A JPEG file that is at least twice as large in both
/// directions is then scaled by a half, a quarter or an eighth while it is decoded, never below `target`, if the
/// program was built with the feature `turbojpeg`.
///
/// Grey is luma with the weights of BT.601, full range. Alpha is ignored. Samples of 16 bits keep the upper eight of the
/// bits that are used (10, 12, 14 or all). A file whose Exif data say that it lies on its side is turned upright. Then
/// the picture is turned, cropped and masked as its camera is [mounted](EncodedPicture::mounted): nobody gets it otherwise.
///
/// # Errors
/// [`FrameFault`] if a limit is exceeded or the picture is broken, even if only its end is missing. The pixels of
/// `into` are then meaningless.
pub fn decode(
    picture: &EncodedPicture,
    limits: &FrameLimits,
    layout: PixelLayout,
    target: Option<PictureSize>,
    into: &mut Picture,
) -> Result<(), FrameFault> {
    check_payload(picture.bytes.len(), limits)?;
    let sent = picture.sent_size();
    check_picture(sent, limits)?;
    let orientation = orientation(picture.format, &picture.bytes);
    let stored = EncodedPicture {
        size: orientation.turned(sent),
        mount: None,
        ..picture.clone()
    };
    let turn = picture.mount().map_or(orientation, |mount| orientation.then(mount.turn()));
    let stored_target = target.map(|target| {
        let uncropped = picture.mount().map_or(target, |mount| mount.whole(target));
        turn.turned(uncropped)
    });
    decode_stored(&stored, limits, layout, stored_target, into)?;
    let whole = turn.turned(into.size);
    let part = picture.mount().map_or(Part::all(whole), |mount| mount.part(whole));
    turn.apply(into, part);
    into.source_size = picture.size;
    if let Some(mount) = picture.mount() {
        mount.paint(into);
    }
    Ok(())
}

/// [`decode`] without turning, cropping and masking.
fn decode_stored(
    picture: &EncodedPicture,
    limits: &FrameLimits,
    layout: PixelLayout,
    target: Option<PictureSize>,
    into: &mut Picture,
) -> Result<(), FrameFault> {
    #[cfg(feature = "turbojpeg")]
    if let (PictureFormat::Jpeg, Some(target)) = (picture.format, target)
        && let Some(scale) = decode_jpeg_scaled::Scale::towards(target, picture.size)
    {
        let is_decoded = contain("JPEG", || {
            decode_jpeg_scaled::decode(picture, scale, layout, into)
        })?;
        if is_decoded {
            return Ok(());
        }
    }
    #[cfg(not(feature = "turbojpeg"))]
    let _ = target;
    let length = decoded_bytes(picture.size, layout.channels(), limits)?;
    into.size = picture.size;
    into.source_size = picture.size;
    into.layout = layout;
    make_room(&mut into.pixels, length)?;
    let pixels = into.pixels.as_mut_slice();
    match picture.format {
        PictureFormat::Jpeg => contain("JPEG", || decode_jpeg::decode(picture, layout, pixels)),
        PictureFormat::Png => contain("PNG", || {
            decode_png::decode(picture, limits, layout, pixels)
        }),
        _ => {
            let raw = raw_picture(picture.format, picture.size, picture.bytes.clone(), limits)?;
            decode_raw::decode(&raw, layout, pixels);
            Ok(())
        }
    }
}

/// Makes `buffer` as long as a picture needs it. If there is no memory for this picture, only this one is lost.
pub(super) fn make_room(buffer: &mut Vec<u8>, length: usize) -> Result<(), FrameFault> {
    let more = length.saturating_sub(buffer.len());
    buffer.try_reserve_exact(more).map_err(|_| {
        FrameFault::oversized(format!(
            "there is no memory for a picture of {length} bytes"
        ))
    })?;
    buffer.resize(length, 0);
    Ok(())
}

/// Turns a panic of a third-party decoder into a fault: decoders read bytes from the network, and a bug that one odd
/// picture triggers must not end the service. The closure leaves only pixels behind.
fn contain<T>(
    decoder: &str,
    decode: impl FnOnce() -> Result<T, FrameFault>,
) -> Result<T, FrameFault> {
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode));
    outcome.unwrap_or_else(|_| {
        Err(FrameFault::undecodable(format!(
            "the {decoder} decoder panicked on the picture"
        )))
    })
}

/// Decodes `picture` in grey and halves it in each direction: every grey value is the rounded mean of a square of four.
/// An odd last row or column is dropped.
///
/// # Errors
/// Same as [`decode`], and for a picture with a side of one pixel, which has no half.
pub fn decode_grey_half(
    picture: &EncodedPicture,
    limits: &FrameLimits,
    into: &mut Picture,
) -> Result<(), FrameFault> {
    decode(picture, limits, PixelLayout::Gray8, None, into)?;
    halve(into)
}

/// Decodes `picture` in grey at a fraction of its size (a half, a quarter, …), the smallest that leaves `width`
/// columns; at its full size if it has fewer than twice as many. JPEG files are scaled while they are decoded, if the
/// program was built with the feature `turbojpeg`.
///
/// # Errors
/// Same as [`decode`].
pub fn decode_small_grey(
    picture: &EncodedPicture,
    limits: &FrameLimits,
    width: u32,
    into: &mut Picture,
) -> Result<(), FrameFault> {
    let least = PictureSize::new(width.max(1), 1);
    decode(picture, limits, PixelLayout::Gray8, Some(least), into)?;
    while into.size.width / 2 >= least.width && into.size.height >= 2 {
        halve(into)?;
    }
    Ok(())
}

/// Halves a grey picture in each direction, in place.
fn halve(into: &mut Picture) -> Result<(), FrameFault> {
    let PictureSize { width, height } = into.size;
    let half = PictureSize::new(width / 2, height / 2);
    if half.pixels() == 0 {
        return Err(FrameFault::undecodable(format!(
            "a picture of {width}x{height} has no half"
        )));
    }
    let row = width as usize;
    let half_row = half.width as usize;
    // Works in place: a value is always written below the addresses that are still to be read.
    for y in 0..half.height as usize {
        for x in 0..half_row {
            let at = 2 * y * row + 2 * x;
            let sum = u16::from(into.pixels[at])
                + u16::from(into.pixels[at + 1])
                + u16::from(into.pixels[at + row])
                + u16::from(into.pixels[at + row + 1]);
            into.pixels[y * half_row + x] = ((sum + 2) / 4) as u8;
        }
    }
    into.pixels.truncate(half_row * half.height as usize);
    into.size = half;
    Ok(())
}

/// Returns the picture as a JPEG file, as its camera is mounted: unchanged if it is a JPEG file from a camera without a
/// mount, else encoded with quality 85.
///
/// # Errors
/// Same as [`decode`].
pub fn to_jpeg(picture: &EncodedPicture, limits: &FrameLimits) -> Result<Bytes, FrameFault> {
    if picture.format == PictureFormat::Jpeg && picture.mount.is_none() {
        return Ok(picture.bytes.clone());
    }
    let (Ok(width), Ok(height)) = (
        u16::try_from(picture.size.width),
        u16::try_from(picture.size.height),
    ) else {
        return Err(FrameFault::oversized(format!(
            "the picture is {}; a JPEG file holds at most 65535x65535",
            picture.size
        )));
    };
    let is_grey = matches!(picture.format, PictureFormat::Gray8 | PictureFormat::Gray16);
    let (layout, color) = if is_grey {
        (PixelLayout::Gray8, jpeg_encoder::ColorType::Luma)
    } else {
        (PixelLayout::Rgb8, jpeg_encoder::ColorType::Rgb)
    };
    let mut decoded = Picture::default();
    decode(picture, limits, layout, None, &mut decoded)?;
    let mut file = Vec::new();
    jpeg_encoder::Encoder::new(&mut file, JPEG_QUALITY)
        .encode(&decoded.pixels, width, height, color)
        .map_err(|error| {
            FrameFault::undecodable(format!("it cannot be encoded as JPEG: {error}"))
        })?;
    Ok(Bytes::from(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_too_large_for_memory_is_a_fault_and_the_next_one_has_room() {
        let mut buffer = vec![1; 8];
        let fault = make_room(&mut buffer, isize::MAX as usize).unwrap_err();
        assert_eq!(fault.kind(), "oversized");
        make_room(&mut buffer, 16).unwrap();
        assert_eq!(buffer.len(), 16);
    }
}
