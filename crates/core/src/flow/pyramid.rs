//! Grey pictures at full size, half, a quarter and so on, each with a mirrored border.

/// A borrowed grey picture.
#[derive(Clone, Copy, Debug)]
pub struct GreyView<'a> {
    width: usize,
    height: usize,
    stride: usize,
    bytes: &'a [u8],
}

impl<'a> GreyView<'a> {
    /// Creates a view of `width` columns and `height` rows that begin every `stride` bytes. `None` if a side is 0 or
    /// above 65,535, the stride is less than the width, or there are too few bytes.
    pub fn new(width: usize, height: usize, stride: usize, bytes: &'a [u8]) -> Option<Self> {
        let sides = 1..=usize::from(u16::MAX);
        let needed = (height.checked_sub(1)?)
            .checked_mul(stride)?
            .checked_add(width)?;
        let usable = sides.contains(&width)
            && sides.contains(&height)
            && stride >= width
            && bytes.len() >= needed;
        usable.then_some(Self {
            width,
            height,
            stride,
            bytes,
        })
    }

    /// Returns the width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    fn row(&self, y: usize) -> &'a [u8] {
        &self.bytes[y * self.stride..][..self.width]
    }
}

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
            self.pixels
                .copy_within(row(above), (BORDER - distance) * stride);
            self.pixels
                .copy_within(row(below), (BORDER + height - 1 + distance) * stride);
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
    levels: Vec<Level>,
    used: usize,
    /// Weighted sums of five rows, including border pixels at both ends.
    sums: Vec<u16>,
}

impl Pyramid {
    /// Fills the pyramid from `picture` with at most `levels` levels; the coarser ones are larger than a window. Each
    /// is the previous level after the Gaussian (1 4 6 4 1)/16 in both directions, every second pixel, rounded: the
    /// same numbers as from OpenCV's `pyrDown`.
    pub fn fill(&mut self, picture: GreyView<'_>, levels: usize) {
        if self.levels.is_empty() {
            self.levels.push(Level::default());
        }
        let Some(finest) = self.levels.first_mut() else {
            return;
        };
        finest.resize(picture.width, picture.height);
        for y in 0..picture.height {
            finest.row_mut(y).copy_from_slice(picture.row(y));
        }
        finest.mirror();
        self.used = 1;
        while self.used < levels {
            if self.levels.len() == self.used {
                self.levels.push(Level::default());
            }
            let Some(([.., larger], [smaller, ..])) = self.levels.split_at_mut_checked(self.used)
            else {
                return;
            };
            let (width, height) = (larger.width.div_ceil(2), larger.height.div_ceil(2));
            if width.min(height) <= super::window::SIDE {
                return;
            }
            smaller.resize(width, height);
            halve(larger, smaller, &mut self.sums);
            smaller.mirror();
            self.used += 1;
        }
    }

    /// Copies the picture of `other`; keeps the buffers.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.used = other.used;
        if self.levels.len() < other.used {
            self.levels.resize_with(other.used, Level::default);
        }
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
        self.levels()
            .first()
            .map_or((0, 0), |level| (level.width, level.height))
    }

    /// Returns the levels, finest first.
    pub(super) fn levels(&self) -> &[Level] {
        self.levels.get(..self.used).unwrap_or_default()
    }
}

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
        let rows = [row(-2), row(-1), row(0), row(1), row(2)];
        let [a, b, c, d, e] = rows;
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

    proptest! {
        /// Against the definition: the weighted mean of 25 pixels, mirrored at the edges.
        #[test]
        fn a_level_has_every_second_pixel_of_the_gaussian(
            width in 23usize..60,
            height in 23usize..60,
            bytes in prop::collection::vec(any::<u8>(), 63 * 60),
        ) {
            let picture = GreyView::new(width, height, width + 3, &bytes).unwrap();
            let mut pyramid = Pyramid::default();
            pyramid.fill(picture, 2);
            let levels = pyramid.levels();
            prop_assert_eq!(levels.len(), 2);
            let weights = [1u32, 4, 6, 4, 1];
            let at = |x: isize, y: isize| {
                u32::from(picture.row(reflect(y, height))[reflect(x, width)])
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
    fn a_view_that_is_no_picture_is_rejected() {
        let bytes = [0; 100];
        assert!(GreyView::new(10, 10, 10, &bytes).is_some());
        assert!(GreyView::new(8, 10, 10, &bytes[..98]).is_some());
        for (width, height, stride, length) in [
            (10, 10, 9, 100),
            (10, 10, 10, 99),
            (0, 10, 10, 100),
            (10, 0, 10, 100),
            (1, usize::MAX, usize::MAX, 100),
        ] {
            assert!(GreyView::new(width, height, stride, &bytes[..length]).is_none());
        }
    }

    #[test]
    fn no_level_is_smaller_than_a_window() {
        let bytes = [0; 64 * 40];
        let mut pyramid = Pyramid::default();
        pyramid.fill(GreyView::new(64, 40, 64, &bytes).unwrap(), 9);
        assert_eq!(pyramid.levels().len(), 2);
        pyramid.fill(GreyView::new(8, 8, 8, &bytes).unwrap(), 9);
        assert_eq!(pyramid.levels().len(), 1);
    }
}
