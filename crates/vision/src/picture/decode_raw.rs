//! Converts raw pixels from one layout to another. Lengths have been checked.

use super::{BayerPattern, EncodedPicture, PictureFormat, PixelLayout};
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
        (PictureFormat::Gray16, _) => {
            decode(&narrow(picture, PictureFormat::Gray8), layout, pixels)
        }
        (PictureFormat::Bayer16(pattern), _) => {
            bayer(
                &narrow(picture, PictureFormat::Bayer(pattern)),
                pattern,
                layout,
                pixels,
            );
        }
        (PictureFormat::Bayer(pattern), _) => bayer(picture, pattern, layout, pixels),
        (
            PictureFormat::Nv12
            | PictureFormat::Nv21
            | PictureFormat::Nv24
            | PictureFormat::I420
            | PictureFormat::Yuyv
            | PictureFormat::Uyvy,
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
        let pixel = y * width + x;
        let in_plane = y / 2 * pairs + x / 2;
        let pair = 4 * (y * pairs + x / 2);
        match format {
            PictureFormat::I420 => [pixel, luma + in_plane, luma + quarter + in_plane],
            PictureFormat::Yuyv => [pair + 2 * (x % 2), pair + 1, pair + 3],
            PictureFormat::Uyvy => [pair + 1 + 2 * (x % 2), pair, pair + 2],
            PictureFormat::Nv21 => [pixel, luma + 2 * in_plane + 1, luma + 2 * in_plane],
            PictureFormat::Nv24 => [pixel, luma + 2 * pixel, luma + 2 * pixel + 1],
            // NV12.
            _ => [pixel, luma + 2 * in_plane, luma + 2 * in_plane + 1],
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
    for (y, row) in pixels.chunks_exact_mut(layout.channels() * width).enumerate() {
        for (x, pixel) in row.chunks_exact_mut(layout.channels()).enumerate() {
            let [luma_place, blue_place, red_place] = places(x, y);
            let luma = scaled(bytes[luma_place]);
            match pixel {
                [grey] => *grey = byte(luma),
                colours => {
                    let blue_difference = i32::from(bytes[blue_place]) - 128;
                    let red_difference = i32::from(bytes[red_place]) - 128;
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

/// The picture with one byte per sample instead of two, in that format.
fn narrow(picture: &EncodedPicture, format: PictureFormat) -> EncodedPicture {
    EncodedPicture {
        format,
        bytes: upper_bits(&picture.bytes, u16::from_le_bytes).into(),
        size: picture.size,
        mount: None,
    }
}

/// The upper eight of the used bits of samples of 16 bits. Cameras write 10, 12 or 14 bits without shifting them up; the
/// brightest sample tells how many are used.
pub(super) fn upper_bits(samples: &[u8], sample: fn([u8; 2]) -> u16) -> Vec<u8> {
    let (samples, _) = samples.as_chunks::<2>();
    let brightest = samples.iter().map(|pair| sample(*pair)).max().unwrap_or_default();
    let used = [10, 12, 14].into_iter().find(|bits| brightest >> bits == 0).unwrap_or(16);
    samples.iter().map(|pair| (sample(*pair) >> (used - 8)) as u8).collect()
}

/// Converts the single colours behind a Bayer filter: the two missing ones of a pixel are the means of its neighbours that
/// have them (bilinear). At an edge, the neighbour on the other side counts twice, which has the same colour.
fn bayer(picture: &EncodedPicture, pattern: BayerPattern, layout: PixelLayout, pixels: &mut [u8]) {
    let width = picture.size.width as usize;
    let height = picture.size.height as usize;
    let bytes = picture.bytes.as_ref();
    let (red_column, red_row) = pattern.red();
    let beside = |at: usize, sides: usize| {
        let last = sides - 1;
        let before = at.checked_sub(1).unwrap_or(last.min(1));
        let after = if at < last {
            at + 1
        } else {
            last.saturating_sub(1)
        };
        (before, after)
    };
    let mean = |samples: &[u8]| {
        let sum = samples.iter().map(|sample| u16::from(*sample)).sum::<u16>();
        (sum / samples.len() as u16) as u8
    };
    let rows = pixels.chunks_exact_mut(layout.channels() * width);
    for (y, converted_row) in rows.enumerate() {
        let (above, below) = beside(y, height);
        let upper = &bytes[above * width..][..width];
        let row = &bytes[y * width..][..width];
        let lower = &bytes[below * width..][..width];
        for (x, pixel) in converted_row.chunks_exact_mut(layout.channels()).enumerate() {
            let (left, right) = beside(x, width);
            let vertical = mean(&[upper[x], lower[x]]);
            let horizontal = mean(&[row[left], row[right]]);
            let in_red_row = y % 2 == red_row;
            let in_red_column = x % 2 == red_column;
            let is_green = in_red_row != in_red_column;
            let own = row[x];
            let [red, green, blue] = if is_green && in_red_row {
                [horizontal, own, vertical]
            } else if is_green {
                [vertical, own, horizontal]
            } else {
                let crossed = mean(&[upper[x], lower[x], row[left], row[right]]);
                let corners = mean(&[upper[left], upper[right], lower[left], lower[right]]);
                if in_red_row {
                    [own, crossed, corners]
                } else {
                    [corners, crossed, own]
                }
            };
            match pixel {
                [grey] => *grey = luma(red, green, blue),
                colours => colours.copy_from_slice(&[red, green, blue]),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATTERNS: [BayerPattern; 4] = [
        BayerPattern::Rggb,
        BayerPattern::Bggr,
        BayerPattern::Gbrg,
        BayerPattern::Grbg,
    ];

    /// A surface whose colours grow evenly, seen behind a colour filter.
    fn seen(pattern: BayerPattern, size: PictureSize) -> Vec<u8> {
        let (red_column, red_row) = pattern.red();
        let mut samples = Vec::new();
        for y in 0..size.height as usize {
            for x in 0..size.width as usize {
                let in_red_row = y % 2 == red_row;
                let in_red_column = x % 2 == red_column;
                let is_green = in_red_row != in_red_column;
                let sample = if is_green {
                    60 + 2 * x + 2 * y
                } else if in_red_row {
                    100 + 2 * x + 4 * y
                } else {
                    20 + 4 * x + 2 * y
                };
                samples.push(sample as u8);
            }
        }
        samples
    }

    #[test]
    fn the_colours_behind_each_bayer_filter_are_found_again() {
        let size = PictureSize::new(8, 6);
        for pattern in PATTERNS {
            let narrow = seen(pattern, size);
            // 12 bits, as sensors write them: the first sample shows that they are used.
            let mut wide = Vec::new();
            for sample in &narrow {
                let shifted = u16::from(*sample) << 4;
                wide.extend_from_slice(&(shifted | 9).to_le_bytes());
            }
            wide[..2].copy_from_slice(&0x0FFF_u16.to_le_bytes());
            for (format, bytes) in [
                (PictureFormat::Bayer(pattern), narrow),
                (PictureFormat::Bayer16(pattern), wide),
            ] {
                let picture = EncodedPicture {
                    format,
                    bytes: bytes.into(),
                    size,
                    mount: None,
                };
                let mut pixels = vec![0; 8 * 6 * 3];
                decode(&picture, PixelLayout::Rgb8, &mut pixels);
                // Inside, away from the edges and the first sample, interpolation is exact.
                for (x, y) in [(3, 2), (4, 2), (3, 3), (4, 3), (6, 4)] {
                    let found = &pixels[3 * (y * 8 + x)..][..3];
                    let truth = [100 + 2 * x + 4 * y, 60 + 2 * x + 2 * y, 20 + 4 * x + 2 * y];
                    assert_eq!(
                        found,
                        truth.map(|sample| sample as u8),
                        "{format:?} at {x}, {y}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_bayer_picture_of_one_pixel_is_grey_in_either_layout() {
        let size = PictureSize::new(1, 1);
        for pattern in PATTERNS {
            let picture = EncodedPicture {
                format: PictureFormat::Bayer(pattern),
                bytes: vec![77].into(),
                size,
                mount: None,
            };
            let mut pixels = [0; 3];
            decode(&picture, PixelLayout::Rgb8, &mut pixels);
            assert_eq!(pixels, [77; 3]);
            let mut grey = [0];
            decode(&picture, PixelLayout::Gray8, &mut grey);
            assert_eq!(grey, [77]);
        }
    }
}
