//! Follows one point from picture to picture, coarse to fine.
//!
//! From the coarsest level on, Gauss-Newton steps search for the window around the point:
//! `d ← d − G⁻¹ Σ (J(x + d) − I(x))·∇I`, `G = Σ ∇I ∇Iᵀ`. The result, doubled, is the guess for the next finer level. A
//! level without texture leaves the guess unchanged, unless it is the finest.

use super::pyramid::Pyramid;
use super::window::{Template, inside};

/// Maximum number of Gauss-Newton steps per level.
const STEPS: u32 = 30;

/// A step of at most this length, pixels of its level, is the last. Two that cancel each other to this are the last, too.
const PRECISION: f32 = 0.01;

/// Smallest texture of a window to search for: the smaller eigenvalue of the mean of `∇I ∇Iᵀ`, in squared grey values per
/// pixel. OpenCV's default of 1e-4, in its units of 32².
const LEAST_TEXTURE: f32 = 0.1024;

/// Follows points between pictures.
#[derive(Clone, Debug, Default)]
pub struct PointTracker {
    template: Template,
}

impl PointTracker {
    /// Returns the shift of `point` from the picture `before` to the picture `after`, searched for around the shift
    /// `guess`. `None` if the point lies outside the pictures or leaves them, has no texture, or the pictures differ in
    /// size.
    pub fn track(
        &mut self,
        before: &Pyramid,
        after: &Pyramid,
        point: [f32; 2],
        guess: [f32; 2],
    ) -> Option<[f32; 2]> {
        let levels = before.levels().iter().zip(after.levels()).enumerate();
        let count = before.levels().len().min(after.levels().len());
        // Half of what it is on the coarsest level, because it is doubled on each.
        let mut shift = guess.map(|shift| shift / power(count));
        // Whether the point could be located on the last level looked at, which is the finest in the end.
        let mut textured = false;
        for (index, (from, to)) in levels.rev() {
            if (from.width, from.height) != (to.width, to.height) {
                return None;
            }
            shift = [shift[0] * 2.0, shift[1] * 2.0];
            let [x, y] = point.map(|place| place / power(index));
            textured = false;
            if !inside(from, x, y) {
                continue;
            }
            let taken = self.template.take(from, x, y);
            if taken.is_none() || self.template.texture() < LEAST_TEXTURE {
                continue;
            }
            textured = true;
            let mut last = [0.0; 2];
            for step in 0..STEPS {
                let moved_x = x + shift[0];
                let moved_y = y + shift[1];
                if !inside(to, moved_x, moved_y) {
                    break;
                }
                let Some([dx, dy]) = self.template.step(to, moved_x, moved_y) else {
                    break;
                };
                shift = [shift[0] + dx, shift[1] + dy];
                if dx * dx + dy * dy <= PRECISION * PRECISION {
                    break;
                }
                // The steps oscillate around the same position: take its middle.
                let cancels_last =
                    (dx + last[0]).abs() < PRECISION && (dy + last[1]).abs() < PRECISION;
                if step > 0 && cancels_last {
                    shift = [shift[0] - dx / 2.0, shift[1] - dy / 2.0];
                    break;
                }
                last = [dx, dy];
            }
        }
        let finest = after.levels().first()?;
        let end = [point[0] + shift[0], point[1] + shift[1]];
        (textured && inside(finest, end[0], end[1])).then_some(shift)
    }
}

/// Returns 2 to the power of a level's number.
fn power(level: usize) -> f32 {
    (1u32 << level.min(31)) as f32
}
