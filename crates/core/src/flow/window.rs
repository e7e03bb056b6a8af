//! The window around a point: its pixels, its gradients along both axes, and its comparison with a position in another
//! picture.
//!
//! Pixels, gradients and their products are integers; a row of the window is processed as sixteen 16-bit lanes, and
//! lanes beyond the window have no effect. Between pixels, values and gradients are interpolated linearly.

use super::pyramid::Level;
use wide::{f32x4, i16x8, i32x4, u8x16};

/// Side of the window, pixels.
pub(super) const SIDE: usize = 11;
/// Lanes in which a row of the window is processed.
const LANES: usize = 16;
/// Pixels from the centre of the window to its edge.
const HALF: i32 = (SIDE / 2) as i32;
/// Scale of the gradients, which are in grey values per pixel times this factor.
const STEEPNESS: f32 = 64.0;
/// Scale of the window's own values, which are grey values times this factor.
const FINENESS: i32 = 8;
/// Positions nearer to a pixel than this count as on it.
const ON_A_PIXEL: f32 = 1.0 / 1024.0;

/// A row of the window and its padding.
type Row = [i16x8; 2];

/// True if the point lies in the picture.
pub(super) fn inside(level: &Level, x: f32, y: f32) -> bool {
    // Written so that NaN is outside.
    x >= 0.0 && y >= 0.0 && x <= (level.width - 1) as f32 && y <= (level.height - 1) as f32
}

/// The window to search for with its gradients, and the position of the search.
///
/// The sum that a Gauss-Newton step needs, `Σ (J(x + d) − I(x))·∇I`, is linear in the weights of the four pixels around
/// a position in J: one pass over the window gives the sums for all positions between the same pixels, and further
/// steps among these cost nothing.
#[derive(Clone, Debug, Default)]
pub(super) struct Template {
    dx: [Row; SIDE],
    dy: [Row; SIDE],
    /// Sums of dx², dx·dy and dy².
    squares: [f32; 3],
    /// Sums of I·dx and I·dy.
    own: [i32; 2],
    /// Sums of (J − I)·dx and (J − I)·dy for the four pixels around the position of the last step.
    differences: [[f32; 2]; 4],
    /// Position of the window's first pixel there.
    at: Option<(i32, i32)>,
}

impl Template {
    /// Takes the window around (x, y); `None` if that point is outside the picture. The gradients are Scharr's, and
    /// zero outside the picture.
    pub(super) fn take(&mut self, level: &Level, x: f32, y: f32) -> Option<()> {
        self.at = None;
        let (column, right) = split(x);
        let (row, below) = split(y);
        let first = (column - HALF, row - HALF);
        if right < ON_A_PIXEL && below < ON_A_PIXEL {
            self.fill::<false>(level, first, [0; 2])
        } else {
            let shares = [fourteen_bits(right), fourteen_bits(below)];
            self.fill::<true>(level, first, shares)
        }
    }

    /// Takes the window whose first pixel is (left, top), or, if `BETWEEN`, lies right of and below it by the given
    /// shares of a pixel.
    fn fill<const BETWEEN: bool>(
        &mut self,
        level: &Level,
        (left, top): (i32, i32),
        [right, below]: [i16; 2],
    ) -> Option<()> {
        // A gradient needs one pixel more on every side; between pixels, one more to the right and below.
        let count = SIDE + 2 + usize::from(BETWEEN);
        let mut rows = level.rows(left - 1, top - 1, count, LANES + 3)?;
        let columns = columns_inside(left, level.width);
        let mut above = Slopes::of::<BETWEEN>(rows.next()?, right)?;
        let mut middle = Slopes::of::<BETWEEN>(rows.next()?, right)?;
        let mut y = top;
        let mut next = || {
            let below = Slopes::of::<BETWEEN>(rows.next()?, right)?;
            let row_inside = i16x8::splat(-i16::from((0..level.height as i32).contains(&y)));
            // Not `map`, which is not reliably inlined; likewise below.
            let inside = [columns[0] & row_inside, columns[1] & row_inside];
            let steepness = Steepness::between(&above, &middle, &below, inside);
            above = std::mem::replace(&mut middle, below);
            y += 1;
            Some(steepness)
        };
        let mut upper = if BETWEEN { Some(next()?) } else { None };
        let mut squares = [f32x4::ZERO; 3];
        let mut own = [i32x4::ZERO; 2];
        for (dx, dy) in self.dx.iter_mut().zip(&mut self.dy) {
            let lower = next()?;
            let row = match &upper {
                Some(upper) => upper.mixed(&lower, below),
                None => lower.clone(),
            };
            if BETWEEN {
                upper = Some(lower);
            }
            let mut row_squares = [i32x4::ZERO; 3];
            for half in 0..2 {
                let across = row.across[half];
                let down = row.down[half];
                row_squares[0] += across.dot(across);
                row_squares[1] += across.dot(down);
                row_squares[2] += down.dot(down);
                own[0] += row.values[half].dot(across);
                own[1] += row.values[half].dot(down);
            }
            *dx = row.across;
            *dy = row.down;
            // The steepest squares of more than a few rows would overflow.
            for (sum, row) in squares.iter_mut().zip(row_squares) {
                *sum += row.round_float();
            }
        }
        let [xx, xy, yy] = squares;
        self.squares = [xx.reduce_add(), xy.reduce_add(), yy.reduce_add()];
        self.own = [own[0].reduce_add(), own[1].reduce_add()];
        Some(())
    }

    /// Returns the smaller eigenvalue of the mean of `∇I ∇Iᵀ`, in squared grey values per pixel: how well the window
    /// can be located in its least textured direction.
    pub(super) fn texture(&self) -> f32 {
        let [xx, xy, yy] = self.squares;
        let root = ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt();
        (xx + yy - root) / (2.0 * (SIDE * SIDE) as f32 * STEEPNESS * STEEPNESS)
    }

    /// Returns the Gauss-Newton step from (x, y) towards the window's position in `level`, which must be the same level
    /// for all steps of a window. `None` outside the picture or without texture.
    pub(super) fn step(&mut self, level: &Level, x: f32, y: f32) -> Option<[f32; 2]> {
        let (column, right) = split(x);
        let (row, below) = split(y);
        let first = (column - HALF, row - HALF);
        if self.at != Some(first) {
            self.at = None;
            self.compare(level, first)?;
            self.at = Some(first);
        }
        let shares = [
            (1.0 - right) * (1.0 - below),
            right * (1.0 - below),
            (1.0 - right) * below,
            right * below,
        ];
        let mut difference = [0.0; 2];
        for (share, [x, y]) in shares.iter().zip(self.differences) {
            difference[0] += share * x;
            difference[1] += share * y;
        }
        let [x, y] = difference;
        let [xx, xy, yy] = self.squares;
        let determinant = xx * yy - xy * xy;
        if determinant <= f32::EPSILON {
            return None;
        }
        // The inverse of the matrix of `squares`, by Cramer's rule, times the difference.
        Some([
            STEEPNESS * (xy * y - yy * x) / determinant,
            STEEPNESS * (xy * x - xx * y) / determinant,
        ])
    }

    /// Fills `differences` for the positions between pixel `(x, y)`, the window's first one, and the next pixels right
    /// and below.
    fn compare(&mut self, level: &Level, (x, y): (i32, i32)) -> Option<()> {
        let mut rows = level.rows(x, y, SIDE + 1, LANES + 1)?;
        let mut sums = [[i32x4::ZERO; 2]; 4];
        let mut above = side_by_side(rows.next()?)?;
        for (row, (dx, dy)) in rows.zip(self.dx.iter().zip(&self.dy)) {
            let below = side_by_side(row)?;
            for half in 0..2 {
                let values = [above[0], above[1], below[0], below[1]];
                for (sums, values) in sums.iter_mut().zip(values) {
                    sums[0] += values[half].dot(dx[half]);
                    sums[1] += values[half].dot(dy[half]);
                }
            }
            above = below;
        }
        for (difference, sums) in self.differences.iter_mut().zip(sums) {
            // Sums of 11 × 11 products of at most 11 and 14 bits: they fit.
            let axis = |axis: usize| {
                let sum = FINENESS * sums[axis].reduce_add() - self.own[axis];
                sum as f32 / FINENESS as f32
            };
            *difference = [axis(0), axis(1)];
        }
        Some(())
    }
}

/// Splits a number above −8 into the integer below it and the remainder.
fn split(value: f32) -> (i32, f32) {
    // Not `floor`, for which older processors have no instruction.
    let whole = (value + 8.0) as i32 - 8;
    (whole, value - whole as f32)
}

/// Converts a share of a pixel, 0 to 1, to units of 2⁻¹⁴.
fn fourteen_bits(share: f32) -> i16 {
    ((share * 16_384.0 + 0.5) as i16).clamp(0, 16_383)
}

/// Returns a mask of the sixteen positions from column `left` on that belong to the window and to a picture of this
/// width: all bits or none.
fn columns_inside(left: i32, width: usize) -> Row {
    if left >= 0 && left + SIDE as i32 <= width as i32 {
        const { assert!(SIDE == 11) };
        let rest = i16x8::new([-1, -1, -1, 0, 0, 0, 0, 0]);
        return [i16x8::splat(-1), rest];
    }
    let place = |half: i32| {
        let inside: [i16; 8] = std::array::from_fn(|index| {
            let place = 8 * half + index as i32;
            let inside = place < SIDE as i32 && (0..width as i32).contains(&(left + place));
            -i16::from(inside)
        });
        i16x8::new(inside)
    };
    [place(0), place(1)]
}

/// The contribution of a row of pixels to values and gradients, from its second pixel on, in eighths of grey values.
struct Slopes {
    values: Row,
    /// The right pixel minus the left one.
    steep: Row,
    /// Pixels smoothed with their neighbours.
    smooth: Row,
}

impl Slopes {
    /// Computes the slopes, if `BETWEEN` for positions `right` · 2⁻¹⁴ of a pixel to the right of the pixels.
    #[inline(always)]
    fn of<const BETWEEN: bool>(row: &[u8], right: i16) -> Option<Self> {
        let row = row.first_chunk::<19>()?;
        let pixels = [sixteen(row, 0)?, sixteen(row, 1)?, sixteen(row, 2)?];
        let [left, values, right] = if BETWEEN {
            let share = i16x8::splat(right);
            let last = sixteen(row, 3)?;
            [
                between(pixels[0], pixels[1], share),
                between(pixels[1], pixels[2], share),
                between(pixels[2], last, share),
            ]
        } else {
            [eighths(pixels[0]), eighths(pixels[1]), eighths(pixels[2])]
        };
        Some(Self {
            values,
            steep: [right[0] - left[0], right[1] - left[1]],
            smooth: [
                smooth(left[0], values[0], right[0]),
                smooth(left[1], values[1], right[1]),
            ],
        })
    }
}

/// Values and gradients of one row of the window.
#[derive(Clone)]
struct Steepness {
    values: Row,
    across: Row,
    down: Row,
}

impl Steepness {
    /// Computes values and gradients of the `middle` row; gradients outside the mask `inside` are zero.
    #[inline(always)]
    fn between(above: &Slopes, middle: &Slopes, below: &Slopes, inside: Row) -> Self {
        let across =
            |half: usize| smooth(above.steep[half], middle.steep[half], below.steep[half]) >> 2u32;
        let down = |half: usize| (below.smooth[half] - above.smooth[half]) >> 2u32;
        Self {
            values: middle.values,
            across: [across(0) & inside[0], across(1) & inside[1]],
            down: [down(0) & inside[0], down(1) & inside[1]],
        }
    }

    /// Interpolates with the row below, whose weight is `share` · 2⁻¹⁴.
    #[inline(always)]
    fn mixed(&self, below: &Self, share: i16) -> Self {
        let fine = i16x8::splat(share);
        let coarse = i16x8::splat(2 * share);
        let values = |half: usize| {
            let step = ((below.values[half] - self.values[half]) << 4u32).mul_keep_high(fine);
            self.values[half] + ((step + i16x8::splat(2)) >> 2u32)
        };
        let gradient = |a: i16x8, b: i16x8| a + ((b - a) << 1u32).mul_keep_high(coarse);
        Self {
            values: [values(0), values(1)],
            across: [
                gradient(self.across[0], below.across[0]),
                gradient(self.across[1], below.across[1]),
            ],
            down: [
                gradient(self.down[0], below.down[0]),
                gradient(self.down[1], below.down[1]),
            ],
        }
    }
}

/// Converts pixels to eighths of grey values.
#[inline(always)]
fn eighths(pixels: Row) -> Row {
    [pixels[0] << 3u32, pixels[1] << 3u32]
}

/// Interpolates between these pixels and those to their right, whose weight is `share` · 2⁻¹⁴, in eighths.
#[inline(always)]
fn between(left: Row, right: Row, share: i16x8) -> Row {
    let half = |half: usize| {
        // 128·255 is the maximum that fits; the result is 32 times the step.
        let step = ((right[half] - left[half]) << 7u32).mul_keep_high(share);
        (left[half] << 3u32) + ((step + i16x8::splat(2)) >> 2u32)
    };
    [half(0), half(1)]
}

/// Scharr's smoothing, times 16.
#[inline(always)]
fn smooth(before: i16x8, middle: i16x8, after: i16x8) -> i16x8 {
    (before + after) * i16x8::splat(3) + middle * i16x8::splat(10)
}

/// Returns sixteen pixels from the first and from the second on.
#[inline(always)]
fn side_by_side(row: &[u8]) -> Option<[Row; 2]> {
    let row = row.first_chunk::<17>()?;
    Some([sixteen(row, 0)?, sixteen(row, 1)?])
}

/// Returns sixteen pixels from position `at` on.
#[inline(always)]
fn sixteen(row: &[u8], at: usize) -> Option<Row> {
    let pixels = u8x16::new(*row.get(at..)?.first_chunk()?);
    Some([
        i16x8::from_u8x16_low(pixels),
        i16x8::from_u8x16_high(pixels),
    ])
}
