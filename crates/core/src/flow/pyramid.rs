//! Grey pictures at full size, half, a quarter and so on, each with a mirrored border.

use crate::geometry::PictureSize;

/// A grey picture, row by row, without padding.
#[derive(Clone, Copy, Debug)]
pub struct GreyPicture<'a> {
    /// Size in pixels.
    pub size: PictureSize,
    /// `width * height` luma values.
    pub pixels: &'a [u8],
}

impl GreyPicture<'_> {
    /// True if the number of pixels matches the size.
    pub(crate) fn is_whole(&self) -> bool {
        self.pixels.len() as u64 == self.size.pixels()
    }
}

/// Maximum number of levels: points are searched in so many, coarse to fine.
const LEVELS: usize = 3;

/// Largest side of a picture.
const LARGEST_SIDE: u32 = 65_535;

/// Border around each level, pixels. A window centred in the picture never leaves it.
pub(super) const BORDER: usize = 16;

/// One level: its pixels and their border.
#[derive(Clone, Debug, Default)]
pub(super) struct Level {
    pub width: usize,
    pub height: usize,
    stride: usize,
    pixels: Vec<u8>,
}

impl Level {
    fn resize(&mut self, width: usize, height: usize) {
        self.width = width;
        self.height = height;
        self.stride = width + 2 * BORDER;
        self.pixels.resize(self.stride * (height + 2 * BORDER), 0);
    }

    /// Returns the pixels of a row without the border.
    fn row_mut(&mut self, y: usize) -> &mut [u8] {
        &mut self.pixels[(y + BORDER) * self.stride + BORDER..][..self.width]
    }

    /// Returns `rows` rows from row `y` on, each with at least `columns` pixels from column `x` on. They may begin and
    /// end in the border; `None` if they exceed it.
    pub(super) fn rows(
        &self,
        x: i32,
        y: i32,
        rows: usize,
        columns: usize,
    ) -> Option<impl Iterator<Item = &[u8]>> {
        let column = usize::try_from(x + BORDER as i32).ok()?;
        let row = usize::try_from(y + BORDER as i32).ok()?;
        if column + columns > self.stride || rows == 0 {
            return None;
        }
        let first = row * self.stride + column;
        let length = (rows - 1) * self.stride + columns;
        let area = self.pixels.get(first..first + length)?;
        Some(area.chunks(self.stride))
    }

    /// Mirrors the picture into the border about its outermost pixels, which are not repeated.
    fn mirror(&mut self) {
        let (width, height, stride) = (self.width, self.height, self.stride);
        for y in 0..height {
            let row = &mut self.pixels[(y + BORDER) * stride..][..stride];
            for distance in 1..=BORDER {
                let left = reflect(-(distance as isize), width);
                let right = reflect((width - 1 + distance) as isize, width);
                row[BORDER - distance] = row[BORDER + left];
                row[BORDER + width - 1 + distance] = row[BORDER + right];
            }
        }
        for distance in 1..=BORDER {
            let above = reflect(-(distance as isize), height) + BORDER;
            let below = reflect((height - 1 + distance) as isize, height) + BORDER;
            let row = |y: usize| y * stride..(y + 1) * stride;
            self.pixels.copy_within(row(above), (BORDER - distance) * stride);
            self.pixels.copy_within(row(below), (BORDER + height - 1 + distance) * stride);
        }
    }
}

/// Returns the index in a row of `length` for position `at`, with the row mirrored at its ends repeatedly.
fn reflect(at: isize, length: usize) -> usize {
    let last = length as isize - 1;
    if last == 0 {
        return 0;
    }
    let folded = at.rem_euclid(2 * last);
    folded.min(2 * last - folded) as usize
}

/// A picture at several sizes. Reuses its buffers when filled again.
#[derive(Clone, Debug, Default)]
pub struct Pyramid {
    levels: [Level; LEVELS],
    used: usize,
    /// Weighted sums of five rows, including border pixels at both ends.
    sums: Vec<u16>,
}

impl Pyramid {
    /// Fills the pyramid from `picture` with at most three levels; the coarser ones are larger than a window. Each is the
    /// previous level after the Gaussian (1 4 6 4 1)/16 in both directions, every second pixel, rounded: the same numbers
    /// as from OpenCV's `pyrDown`. Returns false, without a change, if a side is 0 or above 65,535, or the number of pixels
    /// does not match the size.
    pub fn fill(&mut self, picture: GreyPicture<'_>) -> bool {
        let PictureSize { width, height } = picture.size;
        let sides = 1..=LARGEST_SIDE;
        if !(sides.contains(&width) && sides.contains(&height) && picture.is_whole()) {
            return false;
        }
        let [finest, ..] = &mut self.levels;
        let (width, height) = (width as usize, height as usize);
        finest.resize(width, height);
        for (y, row) in picture.pixels.chunks_exact(width).enumerate() {
            finest.row_mut(y).copy_from_slice(row);
        }
        finest.mirror();
        self.used = 1;
        // The last level that is filled, and the one behind it.
        while let Some(([.., larger], [smaller, ..])) = self.levels.split_at_mut_checked(self.used)
        {
            let (width, height) = (larger.width.div_ceil(2), larger.height.div_ceil(2));
            if width.min(height) <= super::window::SIDE {
                break;
            }
            smaller.resize(width, height);
            halve(larger, smaller, &mut self.sums);
            smaller.mirror();
            self.used += 1;
        }
        true
    }

    /// Copies the picture of `other`; keeps the buffers.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.used = other.used;
        for (level, from) in self.levels.iter_mut().zip(other.levels()) {
            level.width = from.width;
            level.height = from.height;
            level.stride = from.stride;
            level.pixels.clone_from(&from.pixels);
        }
    }

    /// Forgets the picture; keeps the buffers.
    pub fn clear(&mut self) {
        self.used = 0;
    }

    /// True if there is no picture.
    pub fn is_empty(&self) -> bool {
        self.used == 0
    }

    /// Returns the width and height of the picture in pixels, or 0 without one.
    pub fn size(&self) -> (usize, usize) {
        self.levels().first().map_or((0, 0), |level| (level.width, level.height))
    }

    /// Returns the levels, finest first.
    pub(super) fn levels(&self) -> &[Level] {
        self.levels.get(..self.used).unwrap_or_default()
    }
}

/// Fills `smaller` with every second pixel of `larger` after the Gaussian: first down the columns, into `sums`, then
/// along the rows. Weights 1 4 6 4 1 both times; 16·16 = 2⁸.
fn halve(larger: &Level, smaller: &mut Level, sums: &mut Vec<u16>) {
    let width = larger.width;
    sums.clear();
    // The two border pixels that the sums need are part of the rows' border.
    sums.resize(width + 5, 0);
    for y in 0..smaller.height {
        let row = |offset: isize| {
            let at = (2 * y + BORDER).wrapping_add_signed(offset) * larger.stride + BORDER - 2;
            &larger.pixels[at..][..width + 5]
        };
        let a = row(-2);
        let b = row(-1);
        let c = row(0);
        let d = row(1);
        let e = row(2);
        // Zipped, so that no index is checked and the loop becomes vector instructions.
        for (((((sum, a), b), c), d), e) in sums.iter_mut().zip(a).zip(b).zip(c).zip(d).zip(e) {
            *sum = u16::from(*a)
                + u16::from(*e)
                + 4 * (u16::from(*b) + u16::from(*d))
                + 6 * u16::from(*c);
        }
        let target = smaller.row_mut(y);
        for (pixel, five) in target.iter_mut().zip(sums.windows(5).step_by(2)) {
            let [a, b, c, d, e] = *five else { continue };
            // At most 256 · 255, before rounding.
            let sum =
                u32::from(a) + u32::from(e) + 4 * (u32::from(b) + u32::from(d)) + 6 * u32::from(c);
            *pixel = ((sum + 128) >> 8) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn picture(width: usize, height: usize, pixels: &[u8]) -> GreyPicture<'_> {
        let size = PictureSize::new(width as u32, height as u32);
        GreyPicture { size, pixels }
    }

    proptest! {
        /// Against the definition: the weighted mean of 25 pixels, mirrored at the edges.
        #[test]
        fn a_level_has_every_second_pixel_of_the_gaussian(
            width in 23usize..60,
            height in 23usize..60,
            bytes in prop::collection::vec(any::<u8>(), 63 * 60),
        ) {
            let mut pyramid = Pyramid::default();
            prop_assert!(pyramid.fill(picture(width, height, &bytes[..width * height])));
            let levels = pyramid.levels();
            prop_assert!(levels.len() >= 2);
            let weights = [1u32, 4, 6, 4, 1];
            let at = |x: isize, y: isize| {
                u32::from(bytes[reflect(y, height) * width + reflect(x, width)])
            };
            for y in 0..levels[1].height {
                for x in 0..levels[1].width {
                    let mut sum = 0;
                    for (j, wj) in weights.iter().enumerate() {
                        for (i, wi) in weights.iter().enumerate() {
                            let (x, y) = (2 * x + i, 2 * y + j);
                            sum += wi * wj * at(x as isize - 2, y as isize - 2);
                        }
                    }
                    prop_assert_eq!(u32::from(levels[1].pixels[(y + BORDER) * levels[1].stride + BORDER + x]), (sum + 128) / 256);
                }
            }
            for (x, y) in [(-16, -16), (-1, 5), (width as i32 + 15, height as i32 + 15)] {
                let pixel = levels[0].rows(x, y, 1, 1).unwrap().next().unwrap()[0];
                prop_assert_eq!(u32::from(pixel), at(x as isize, y as isize));
            }
        }
    }

    #[test]
    fn numbers_that_are_no_picture_are_rejected() {
        let bytes = [0; 100];
        let mut pyramid = Pyramid::default();
        assert!(pyramid.fill(picture(10, 10, &bytes)));
        for (width, height, length) in [
            (10, 9, 100),
            (10, 10, 99),
            (0, 10, 0),
            (10, 0, 0),
            (0, 0, 0),
            (1, u32::MAX as usize, 100),
        ] {
            assert!(!pyramid.fill(picture(width, height, &bytes[..length])));
            assert_eq!(pyramid.size(), (10, 10));
        }
        assert!(!pyramid.fill(picture(65_536, 1, &[0; 65_536])));
    }

    #[test]
    fn no_level_is_smaller_than_a_window() {
        let mut pyramid = Pyramid::default();
        pyramid.fill(picture(64, 40, &[0; 64 * 40]));
        assert_eq!(pyramid.levels().len(), 2);
        pyramid.fill(picture(8, 8, &[0; 64]));
        assert_eq!(pyramid.levels().len(), 1);
    }
}
