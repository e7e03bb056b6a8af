//! Converts raw pixels from one layout to another. Lengths have been checked.

use super::{EncodedPicture, PictureFormat, PixelLayout};
use albireo_core::geometry::PictureSize;

/// Converts into `pixels`, which has the length for `picture.size` and `layout`; `picture.bytes` has the length for its
/// size and format.
pub(super) fn decode(picture: &EncodedPicture, layout: PixelLayout, pixels: &mut [u8]) {
    let bytes = picture.bytes.as_ref();
    match (picture.format, layout) {
        (PictureFormat::Rgb8, PixelLayout::Rgb8) | (PictureFormat::Gray8, PixelLayout::Gray8) => {
            pixels.copy_from_slice(bytes);
        }
        (PictureFormat::Gray8, PixelLayout::Rgb8) => grey_to_rgb::<1>(bytes, pixels),
        (PictureFormat::Rgb8, _) => colours::<3>(bytes, [0, 1, 2], layout, pixels),
        (PictureFormat::Bgr8, _) => colours::<3>(bytes, [2, 1, 0], layout, pixels),
        (PictureFormat::Rgba8, _) => colours::<4>(bytes, [0, 1, 2], layout, pixels),
        (PictureFormat::Bgra8, _) => colours::<4>(bytes, [2, 1, 0], layout, pixels),
        (
            PictureFormat::Nv12 | PictureFormat::I420 | PictureFormat::Yuyv | PictureFormat::Uyvy,
            _,
        ) => ycbcr(picture, layout, pixels),
        // Not raw.
        (PictureFormat::Jpeg | PictureFormat::Png, _) => {}
    }
}

/// Returns the luma of full-range red, green and blue with the weights of BT.601, in 16-bit fixed point.
fn luma(red: u8, green: u8, blue: u8) -> u8 {
    let sum = 19595 * u32::from(red) + 38470 * u32::from(green) + 7471 * u32::from(blue);
    ((sum + (1 << 15)) >> 16) as u8
}

/// Converts pixels of `N` bytes with red, green and blue at `order`.
pub(super) fn colours<const N: usize>(
    from: &[u8],
    order: [usize; 3],
    layout: PixelLayout,
    to: &mut [u8],
) {
    let (from, _) = from.as_chunks::<N>();
    let [red, green, blue] = order;
    match layout {
        PixelLayout::Rgb8 => {
            let (to, _) = to.as_chunks_mut::<3>();
            for (to, from) in to.iter_mut().zip(from) {
                *to = [from[red], from[green], from[blue]];
            }
        }
        PixelLayout::Gray8 => {
            for (to, from) in to.iter_mut().zip(from) {
                *to = luma(from[red], from[green], from[blue]);
            }
        }
    }
}

/// Converts red, green, blue to luma.
pub(super) fn rgb_to_grey(from: &[u8], to: &mut [u8]) {
    colours::<3>(from, [0, 1, 2], PixelLayout::Gray8, to);
}

/// Converts pixels of `N` bytes with luma first to red, green, blue.
pub(super) fn grey_to_rgb<const N: usize>(from: &[u8], to: &mut [u8]) {
    let (from, _) = from.as_chunks::<N>();
    let (to, _) = to.as_chunks_mut::<3>();
    for (to, from) in to.iter_mut().zip(from) {
        *to = [from[0]; 3];
    }
}

/// Where the samples of a YCbCr picture lie: for a pixel in column `x` of row `y`, the places of its luma, Cb and Cr.
fn samples(format: PictureFormat, size: PictureSize) -> impl Fn(usize, usize) -> [usize; 3] {
    let width = size.width as usize;
    let luma = width * size.height as usize;
    let pairs = width.div_ceil(2);
    let quarter = pairs * (size.height as usize).div_ceil(2);
    move |x, y| {
        let in_plane = y / 2 * pairs + x / 2;
        let pair = 4 * (y * pairs + x / 2);
        match format {
            PictureFormat::I420 => [y * width + x, luma + in_plane, luma + quarter + in_plane],
            PictureFormat::Yuyv => [pair + 2 * (x % 2), pair + 1, pair + 3],
            PictureFormat::Uyvy => [pair + 1 + 2 * (x % 2), pair, pair + 2],
            _ => [y * width + x, luma + 2 * in_plane, luma + 2 * in_plane + 1],
        }
    }
}

/// Converts YCbCr in the limited range of BT.601 (ITU-R BT.601-7, section 2.5: black 16, white 235); a chroma sample
/// applies to all pixels of its pair or square. Fixed-point factors: 298/256 = 255/219, and so on.
fn ycbcr(picture: &EncodedPicture, layout: PixelLayout, pixels: &mut [u8]) {
    let width = picture.size.width as usize;
    let bytes = picture.bytes.as_ref();
    let places = samples(picture.format, picture.size);
    let scaled = |luma: u8| 298 * (i32::from(luma) - 16) + 128;
    let byte = |value: i32| (value >> 8).clamp(0, 255) as u8;
    for (y, to) in pixels.chunks_exact_mut(layout.channels() * width).enumerate() {
        for (x, to) in to.chunks_exact_mut(layout.channels()).enumerate() {
            let [luma, blue, red] = places(x, y);
            let luma = scaled(bytes[luma]);
            match to {
                [grey] => *grey = byte(luma),
                colours => {
                    let blue_difference = i32::from(bytes[blue]) - 128;
                    let red_difference = i32::from(bytes[red]) - 128;
                    colours.copy_from_slice(&[
                        byte(luma + 409 * red_difference),
                        byte(luma - 100 * blue_difference - 208 * red_difference),
                        byte(luma + 516 * blue_difference),
                    ]);
                }
            }
        }
    }
}
