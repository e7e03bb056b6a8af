//! The rules for creating, confirming, rescuing and removing objects.

use super::ObjectState;
use crate::geometry::BoundingBox;

/// The rules of birth and death.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LifeCycle {
    /// Detections that confirm an object, including the one that created it. Paper: "multiple".
    pub hits_to_confirm: u32,
    /// Smallest last confidence of an object to rescue (paper, c_rescue).
    pub c_rescue: f64,
    /// Consecutive rescues after which the next miss removes the object (paper, R_max). Predicted frames in between
    /// neither count nor interrupt the sequence.
    pub r_max: u32,
    /// True if a rescue resets the age limited by T_max to zero, as a detection does. Published code: yes; paper: no,
    /// ΔT counts from the last real measurement.
    pub rescue_resets_age: bool,
    /// Largest distance of a centre outside the picture, as a share of it, before its object is removed. Published
    /// code: 0.05; paper: 0 ("leaves the frame").
    pub boundary_margin: f64,
}

/// The fate of an object that the detector missed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missed {
    /// The object is kept, and its predicted box is reported.
    Rescued,
    /// The object is removed.
    Removed,
}

impl LifeCycle {
    /// Decides the fate of an object without a matching detection in this frame, and counts the miss. A tentative
    /// object is removed at the first miss (published code; the paper mentions only confirmed objects).
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

    /// True if an object with this box has left the picture.
    #[inline]
    pub(crate) fn has_left(&self, bounding_box: BoundingBox) -> bool {
        let inside = -self.boundary_margin..=1.0 + self.boundary_margin;
        !(inside.contains(&bounding_box.center_x) && inside.contains(&bounding_box.center_y))
    }
}
