//! The motion of a box, from a grid of points followed forward and back.
//!
//! With p a point, d its shift and c the centre of the box, over the points that return to within [`LARGEST_RETURN`] of
//! their start:
//!
//! ```text
//! scale s  = median over pairs of |p'ᵢ − p'ⱼ| / |pᵢ − pⱼ|
//! shift    = median of d − (s − 1)(p − c)
//! residual = d − shift − (s − 1)(p − c)
//! spread   = median |residual| / smaller side of the box
//! ```
//!
//! Median Flow takes the median of d itself. That is the shift of the points' centre, which differs from the box's if
//! the kept points lie to one side and the box grows.

use super::median::median;
use super::pyramid::Pyramid;
use super::tracker::PointTracker;
use crate::geometry::Corners;

/// Share of the box's sides that the grid spans: at its edges a box shows more of what lies behind the object.
const INNER: f32 = 0.7;

/// Largest distance between a kept point's start and its return, pixels.
const LARGEST_RETURN: f32 = 1.0;

/// Smallest number of kept points.
const LEAST_POINTS: usize = 8;

/// The motion of a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxMotion {
    /// Shift of the centre, pixels.
    pub shift: [f64; 2],
    /// Scale factor of the sides.
    pub scale: f64,
    /// Median distance of the points from their positions by shift and scale, relative to the smaller side of the box.
    pub spread: f64,
}

/// The result of following a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Followed {
    /// Number of grid points inside the picture.
    pub points: usize,
    /// Number of points that returned.
    pub kept: usize,
    /// The motion; `None` if too few points returned.
    pub motion: Option<BoxMotion>,
}

impl Followed {
    /// Returns the share of the points that returned; 0 without points.
    pub fn agreement(&self) -> f64 {
        if self.points == 0 {
            0.0
        } else {
            self.kept as f64 / self.points as f64
        }
    }
}

/// The start and end of a grid point.
#[derive(Clone, Copy, Debug)]
struct Pair {
    start: [f32; 2],
    end: [f32; 2],
}

/// Follows boxes between pictures.
#[derive(Clone, Debug)]
pub struct BoxFlow {
    grid: usize,
    tracker: PointTracker,
    pairs: Vec<Pair>,
    values: Vec<f32>,
}

impl BoxFlow {
    /// Creates a follower with `grid` points along each side of a box.
    pub fn new(grid: usize) -> Self {
        let points = grid * grid;
        Self {
            grid,
            tracker: PointTracker::default(),
            pairs: Vec::with_capacity(points),
            values: Vec::with_capacity(points * points / 2),
        }
    }

    /// Follows the box `area` of the picture `before`, in its pixels, into the picture `after`. The search begins at
    /// `guess`, the expected shift of the box, pixels.
    pub fn follow(
        &mut self,
        before: &Pyramid,
        after: &Pyramid,
        area: Corners,
        guess: [f64; 2],
    ) -> Followed {
        let points = self.track_points(before, after, area, guess);
        let kept = self.pairs.len();
        let motion = if kept >= LEAST_POINTS {
            self.motion(area)
        } else {
            None
        };
        Followed {
            points,
            kept,
            motion,
        }
    }

    /// Fills `pairs`; returns the number of points to follow.
    fn track_points(
        &mut self,
        before: &Pyramid,
        after: &Pyramid,
        area: Corners,
        guess: [f64; 2],
    ) -> usize {
        self.pairs.clear();
        let (width, height) = before.size();
        let rows = Grid::along(area.y1, area.y2, height, self.grid);
        let columns = Grid::along(area.x1, area.x2, width, self.grid);
        let (Some(rows), Some(columns)) = (rows, columns) else {
            return 0;
        };
        let guess = guess.map(|shift| shift as f32);
        for row in 0..self.grid {
            for column in 0..self.grid {
                let start = [columns.place(column), rows.place(row)];
                let Some(shift) = self.tracker.track(before, after, start, guess) else {
                    continue;
                };
                let end = [start[0] + shift[0], start[1] + shift[1]];
                let back = [-guess[0], -guess[1]];
                let Some(back) = self.tracker.track(after, before, end, back) else {
                    continue;
                };
                if squared(shift, [-back[0], -back[1]]) <= LARGEST_RETURN * LARGEST_RETURN {
                    self.pairs.push(Pair { start, end });
                }
            }
        }
        self.grid * self.grid
    }

    fn motion(&mut self, area: Corners) -> Option<BoxMotion> {
        let scale = self.scale()?;
        let growth = scale - 1.0;
        let middle = [
            ((area.x1 + area.x2) / 2.0) as f32,
            ((area.y1 + area.y2) / 2.0) as f32,
        ];
        let mut shift = [0.0; 2];
        for (axis, shift) in shift.iter_mut().enumerate() {
            self.values.clear();
            for pair in &self.pairs {
                let grown = growth * (pair.start[axis] - middle[axis]);
                self.values.push(pair.end[axis] - pair.start[axis] - grown);
            }
            *shift = median(&mut self.values);
        }
        self.values.clear();
        for pair in &self.pairs {
            let expected = [0, 1].map(|axis| {
                pair.start[axis] + shift[axis] + growth * (pair.start[axis] - middle[axis])
            });
            self.values.push(squared(pair.end, expected).sqrt());
        }
        let side = (area.x2 - area.x1).min(area.y2 - area.y1);
        let motion = BoxMotion {
            shift: shift.map(f64::from),
            scale: f64::from(scale),
            spread: f64::from(median(&mut self.values)) / side,
        };
        let finite = motion.shift[0].is_finite()
            && motion.shift[1].is_finite()
            && motion.scale.is_finite()
            && motion.spread.is_finite();
        (finite && motion.scale > 0.0).then_some(motion)
    }

    /// Returns the median ratio of distances after and before. The root of a median is the median of the roots.
    fn scale(&mut self) -> Option<f32> {
        self.values.clear();
        for (index, one) in self.pairs.iter().enumerate() {
            for other in self.pairs.get(index + 1..).unwrap_or_default() {
                let before = squared(one.start, other.start);
                let after = squared(one.end, other.end);
                // Points of a tiny box may be of one pixel, and tell nothing of its growth.
                if before > 0.0 {
                    self.values.push(after / before);
                }
            }
        }
        let ratio = median(&mut self.values);
        (ratio.is_finite() && ratio > 0.0).then(|| ratio.sqrt())
    }
}

/// Evenly spaced positions along one axis, rounded to whole pixels.
struct Grid {
    first: f32,
    distance: f32,
}

impl Grid {
    /// Returns the grid of `points` in the part of a side from `low` to `high` inside a picture of `length` pixels; `None`
    /// if that part is empty.
    fn along(low: f64, high: f64, length: usize, points: usize) -> Option<Self> {
        let low = low.max(0.0);
        let high = high.min(length as f64 - 1.0);
        if low >= high {
            return None;
        }
        let span = (high - low) as f32 * INNER;
        let middle = ((low + high) / 2.0) as f32;
        Some(Self {
            first: middle - span / 2.0,
            distance: span / points.saturating_sub(1).max(1) as f32,
        })
    }

    fn place(&self, index: usize) -> f32 {
        (self.first + self.distance * index as f32).round()
    }
}

/// The squared distance of two points.
fn squared(a: [f32; 2], b: [f32; 2]) -> f32 {
    let dx = a[0] - b[0];
    let dy = a[1] - b[1];
    dx * dx + dy * dy
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_one_pixel_tell_nothing_of_the_growth_of_a_box() {
        let on_one_pixel = Pair {
            start: [0.0, 0.0],
            end: [0.0, 0.0],
        };
        let other = Pair {
            start: [2.0, 0.0],
            end: [3.0, 0.0],
        };
        let mut flow = BoxFlow::new(2);
        flow.pairs = vec![on_one_pixel, on_one_pixel, on_one_pixel, other];
        assert_eq!(flow.scale(), Some(1.5));
    }
}
