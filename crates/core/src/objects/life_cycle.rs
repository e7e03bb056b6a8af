//! Rules for when an object is created, confirmed, rescued and removed.

use super::ObjectState;
use crate::geometry::BoundingBox;

/// The rules of birth and death.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LifeCycle {
    /// Detections that make an object confirmed; the creating one is the first. Paper: "multiple".
    pub hits_to_confirm: u32,
    /// Detector frames in a row that a tentative object may be missed in and stay. The published code
    /// removes it at the first; the paper speaks of confirmed objects only.
    pub tentative_misses: u32,
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
    /// Smallest side of an estimated box, pixels. Not in the paper.
    pub minimum_side: f64,
    /// Whether every detector frame creates objects from the detections that match none. The published
    /// code does so; the paper says it of `E+I` frames only, under which nothing that enters a busy
    /// scene would ever be followed.
    pub creates_on_every_detector_frame: bool,
    /// Frames lost in a row after which all objects are forgotten. Neither paper nor code lose frames.
    pub longest_gap: u32,
}

/// What becomes of an object that the detector missed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missed {
    /// It is still there and its predicted box is reported.
    Rescued,
    /// It stays, without a box.
    Kept,
    /// It is gone.
    Removed,
}

impl LifeCycle {
    /// Decides on an object that no detection of this frame matched, and counts the miss.
    pub fn missed(&self, state: &mut ObjectState) -> Missed {
        let (allowed, verdict) = if !state.confirmed {
            (self.tentative_misses, Missed::Kept)
        } else if state.confidence >= self.c_rescue {
            (self.r_max, Missed::Rescued)
        } else {
            (0, Missed::Removed)
        };
        if state.misses >= allowed {
            return Missed::Removed;
        }
        state.misses += 1;
        if verdict == Missed::Rescued && self.rescue_resets_age {
            state.since_infer = 0;
        }
        verdict
    }

    /// Whether an object whose box is here has left the picture.
    #[inline]
    pub(crate) fn has_left(&self, bounding_box: BoundingBox) -> bool {
        let inside = -self.boundary_margin..=1.0 + self.boundary_margin;
        !(inside.contains(&bounding_box.center_x) && inside.contains(&bounding_box.center_y))
    }
}
