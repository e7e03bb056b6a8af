//! Rules for when an object is created, confirmed, rescued and removed.

use super::ObjectState;
use crate::geometry::BoundingBox;

/// The rules of birth and death.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LifeCycle {
    /// Detections that make an object confirmed; the creating one is the first. Paper: "multiple".
    pub hits_to_confirm: u32,
    /// Smallest last confidence of an object that is rescued (paper, c_rescue).
    pub c_rescue: f64,
    /// Rescues in a row after which the next miss removes the object (paper, R_max). Predicted frames
    /// in between neither count nor interrupt the row.
    pub r_max: u32,
    /// Whether a rescue sets the age that T_max limits back to zero, as a detection does. Published
    /// code: yes; paper: no, ΔT counts from the last real measurement.
    pub rescue_resets_age: bool,
    /// How far outside the picture, as a share of it, a centre may lie before its object is removed.
    /// Published code: 0.05; paper: 0 ("leaves the frame").
    pub boundary_margin: f64,
}

/// What becomes of an object that the detector missed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missed {
    /// It is still there and its predicted box is reported.
    Rescued,
    /// It is gone.
    Removed,
}

impl LifeCycle {
    /// Decides on an object that no detection of this frame matched, and counts the miss. A tentative object is removed at
    /// the first (published code; the paper speaks of confirmed objects only).
    pub fn missed(&self, state: &mut ObjectState) -> Missed {
        let may_be_rescued = state.confirmed && state.confidence >= self.c_rescue;
        if !may_be_rescued || state.misses >= self.r_max {
            return Missed::Removed;
        }
        state.misses += 1;
        if self.rescue_resets_age {
            state.since_infer = 0;
        }
        Missed::Rescued
    }

    /// Whether an object whose box is here has left the picture.
    #[inline]
    pub(crate) fn has_left(&self, bounding_box: BoundingBox) -> bool {
        let inside = -self.boundary_margin..=1.0 + self.boundary_margin;
        !(inside.contains(&bounding_box.center_x) && inside.contains(&bounding_box.center_y))
    }
}
