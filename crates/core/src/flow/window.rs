//! The window around a point: what it looks like, how it changes along both axes, and how well a place in
//! another picture agrees.
//!
//! All sums over a window are of whole numbers of 16 bits, and exact. A row is worked on as sixteen numbers at once;
//! those behind the window count for nothing.

use super::pyramid::Level;
use wide::{f32x4, i16x8, i32x4, u8x16};

/// Side of the window, pixels.
pub(super) const SIDE: usize = 11;
/// Pixels from the middle of the window to its edge.
const HALF: i32 = (SIDE / 2) as i32;
/// Gradients are in grey values a pixel times so much.
const STEEPNESS: f32 = 32.0;

/// A row of the window and what stands behind it.
type Row = [i16x8; 2];

/// Whether the point lies in the picture.
pub(super) fn inside(level: &Level, x: f32, y: f32) -> bool {
    // Written so that NaN lies nowhere.
    x >= 0.0 && y >= 0.0 && x <= (level.width - 1) as f32 && y <= (level.height - 1) as f32
}

/// What is searched for, a window with its gradients, and where the search is.
///
/// What a Gauss-Newton step needs, `Σ (J(x + d) − I(x))·∇I`, is linear in the shares that the four pixels around a
/// place have in J: one pass over the window gives the sums for all places between the same pixels, and further
/// steps among these cost nothing.
#[derive(Clone, Debug)]
pub(super) struct Template {
    dx: [Row; SIDE],
    dy: [Row; SIDE],
    /// Sums of dx², dx·dy and dy².
    squares: [f32; 3],
    /// Sums of I·dx and I·dy.
    own: [i32; 2],
    /// Sums of (J − I)·dx and (J − I)·dy for the four pixels around the place of the last step.
    differences: [[f32; 2]; 4],
    /// Where the window has its first pixel there.
    at: Option<(i32, i32)>,
}

impl Template {
    /// No window yet.
    pub(super) const fn empty() -> Self {
        Self {
            dx: [[i16x8::ZERO; 2]; SIDE],
            dy: [[i16x8::ZERO; 2]; SIDE],
            squares: [0.0; 3],
            own: [0; 2],
            differences: [[0.0; 2]; 4],
            at: None,
        }
    }

    /// Takes the window around the pixel (x, y), which must lie in the picture; `None` if it does not. The
    /// gradients are Scharr's, and zero outside of the picture.
    pub(super) fn take(&mut self, level: &Level, x: i32, y: i32) -> Option<()> {
        self.at = None;
        let (left, top) = (x - HALF, y - HALF);
        // One pixel more on every side.
        let mut rows = level.rows(left - 1, top - 1, SIDE + 2, 16 + 2)?;
        let columns = columns_inside(left, level.width);
        let mut squares = [f32x4::ZERO; 3];
        let mut own = [i32x4::ZERO; 2];
        let mut above = Slopes::of(rows.next()?)?;
        let mut middle = Slopes::of(rows.next()?)?;
        let gradients = self.dx.iter_mut().zip(&mut self.dy);
        for ((y, row), (dx, dy)) in (top..).zip(rows).zip(gradients) {
            let below = Slopes::of(row)?;
            let row_inside = i16x8::splat(-i16::from((0..level.height as i32).contains(&y)));
            let mut row_squares = [i32x4::ZERO; 3];
            for half in 0..2 {
                let inside = columns[half] & row_inside;
                let across = smooth(above.steep[half], middle.steep[half], below.steep[half]);
                let down = below.smooth[half] - above.smooth[half];
                let (across, down) = (across & inside, down & inside);
                dx[half] = across;
                dy[half] = down;
                row_squares[0] += across.dot(across);
                row_squares[1] += across.dot(down);
                row_squares[2] += down.dot(down);
                own[0] += middle.values[half].dot(across);
                own[1] += middle.values[half].dot(down);
            }
            // More than a row of the steepest squares would not fit.
            for (sum, row) in squares.iter_mut().zip(row_squares) {
                *sum += row.round_float();
            }
            (above, middle) = (middle, below);
        }
        self.squares = squares.map(f32x4::reduce_add);
        self.own = own.map(i32x4::reduce_add);
        Some(())
    }

    /// The smaller eigenvalue of the mean of `∇I ∇Iᵀ`, in squared grey values a pixel: how well the window can be
    /// located in the direction it is least textured in.
    pub(super) fn texture(&self) -> f32 {
        let [xx, xy, yy] = self.squares;
        let root = ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt();
        (xx + yy - root) / (2.0 * (SIDE * SIDE) as f32 * STEEPNESS * STEEPNESS)
    }

    /// The Gauss-Newton step from (x, y) towards where the window is found in `level`, the same one since the
    /// window was taken. `None` outside of the picture or without texture.
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
        let mut b = [0.0; 2];
        for (share, [x, y]) in shares.iter().zip(self.differences) {
            b[0] += share * x;
            b[1] += share * y;
        }
        let [xx, xy, yy] = self.squares;
        let determinant = xx * yy - xy * xy;
        (determinant > f32::EPSILON).then(|| {
            [
                STEEPNESS * (xy * b[1] - yy * b[0]) / determinant,
                STEEPNESS * (xy * b[0] - xx * b[1]) / determinant,
            ]
        })
    }

    /// Fills `differences` for the places between the pixel `(x, y)`, with the window's first pixel there, and the
    /// next ones to the right and below.
    fn compare(&mut self, level: &Level, (x, y): (i32, i32)) -> Option<()> {
        let mut rows = level.rows(x, y, SIDE + 1, 16 + 1)?;
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
            // Of eleven times eleven products of 8 and 13 bits.
            *difference = [
                (sums[0].reduce_add() - self.own[0]) as f32,
                (sums[1].reduce_add() - self.own[1]) as f32,
            ];
        }
        Some(())
    }
}

/// The whole number below a number above −8, and how far it lies below.
fn split(value: f32) -> (i32, f32) {
    // Not `floor`, which older processors have no instruction for.
    let whole = (value + 8.0) as i32 - 8;
    (whole, value - whole as f32)
}

/// Which of the sixteen places from column `left` on belong to the window and to a picture of this width: all bits
/// or none.
fn columns_inside(left: i32, width: usize) -> Row {
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

/// What a row of pixels has to give to the gradients, from the second pixel on.
#[derive(Clone, Copy)]
struct Slopes {
    values: Row,
    /// The pixel to the right less the one to the left.
    steep: Row,
    /// Pixels mixed with those beside them.
    smooth: Row,
}

impl Slopes {
    #[inline(always)]
    fn of(row: &[u8]) -> Option<Self> {
        let row = row.first_chunk::<18>()?;
        let (left, values, right) = (sixteen(row, 0)?, sixteen(row, 1)?, sixteen(row, 2)?);
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

/// Scharr's mixture, times 16.
#[inline(always)]
fn smooth(before: i16x8, middle: i16x8, after: i16x8) -> i16x8 {
    (before + after) * i16x8::splat(3) + middle * i16x8::splat(10)
}

/// Sixteen pixels from the first and from the second on.
#[inline(always)]
fn side_by_side(row: &[u8]) -> Option<[Row; 2]> {
    let row = row.first_chunk::<17>()?;
    Some([sixteen(row, 0)?, sixteen(row, 1)?])
}

/// Sixteen pixels from place `at` on.
#[inline(always)]
fn sixteen(row: &[u8], at: usize) -> Option<Row> {
    let pixels = u8x16::new(*row.get(at..)?.first_chunk()?);
    Some([
        i16x8::from_u8x16_low(pixels),
        i16x8::from_u8x16_high(pixels),
    ])
}
