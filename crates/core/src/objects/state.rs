//! The state of one object.

use crate::detection::{ClassId, Detection, ObjectId};
use crate::geometry::BoundingBox;
use crate::kalman::{Filter, FilterModel};

/// The state of one object in view.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectState {
    /// Number in the stream.
    pub id: ObjectId,
    /// Class of the last detection.
    pub class: ClassId,
    /// False while the object is tentative; true permanently once enough detections have matched it.
    pub confirmed: bool,
    /// Confidence of the last detection.
    pub confidence: f64,
    /// Box of the last detection.
    pub detected: BoundingBox,
    /// Detections matched so far, including the one that created the object.
    pub hits: u32,
    /// Frames since the last detection.
    pub since_update: u32,
    /// Frames since the detector last measured or missed the object: its age under T_max (paper, ΔT).
    pub since_infer: u32,
    /// Consecutive detector frames that missed the object and that it survived: a confirmed object's rescues.
    pub misses: u32,
    /// Filter with the object's estimated box and its uncertainty.
    pub filter: Filter,
}

impl ObjectState {
    /// Creates an object from an unmatched detection.
    pub fn new(
        id: ObjectId,
        detection: &Detection,
        hits_to_confirm: u32,
        model: &FilterModel,
    ) -> Self {
        Self {
            id,
            class: detection.class,
            confirmed: hits_to_confirm <= 1,
            confidence: detection.confidence,
            detected: detection.bounding_box,
            hits: 1,
            since_update: 0,
            since_infer: 0,
            misses: 0,
            filter: Filter::new(model, detection.bounding_box),
        }
    }

    /// Advances by one frame.
    #[inline]
    pub(crate) fn predict(&mut self, model: &FilterModel) {
        self.filter.predict(model);
        self.since_update = self.since_update.saturating_add(1);
        self.since_infer = self.since_infer.saturating_add(1);
    }

    /// Updates the object with its matched detection.
    #[inline]
    pub fn update(&mut self, detection: &Detection, hits_to_confirm: u32, model: &FilterModel) {
        self.filter.update(model, detection.bounding_box);
        self.class = detection.class;
        self.confidence = detection.confidence;
        self.detected = detection.bounding_box;
        self.hits = self.hits.saturating_add(1);
        self.confirmed |= self.hits >= hits_to_confirm;
        self.since_update = 0;
        self.since_infer = 0;
        self.misses = 0;
    }
}
