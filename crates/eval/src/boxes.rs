//! Defines the boxes that are judged, in pixels.

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{Corners, PictureSize};

/// A box with a confidence: a box to be judged, a stored detection, or ground truth, whose confidence is 1 and ignored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoredBox {
    /// The box in pixels.
    pub corners: Corners,
    /// The class; compared only if classes are judged separately.
    pub class: ClassId,
    /// The confidence, by which boxes are ranked. Must not be NaN (a NaN ranks first).
    pub confidence: f64,
    /// Number of the object it shows, the same in every frame; only [`tracking`](crate::judge::tracking()) uses it.
    pub object: Option<u64>,
}

impl ScoredBox {
    /// Converts to a detection as policies take it.
    pub fn normalise(self, picture: PictureSize) -> Detection {
        Detection {
            bounding_box: self.corners.normalise(picture),
            class: self.class,
            confidence: self.confidence,
        }
    }
}
