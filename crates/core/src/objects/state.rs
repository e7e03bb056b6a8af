//! The state of one object.

use crate::detection::ObjectId;
use crate::detection::{ClassId, Detection};
use crate::geometry::BoundingBox;
use crate::kalman::{Filter, FilterModel};

/// The state of one object in view.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectState {
    /// Its number in the stream.
    pub id: ObjectId,
    /// Class of its last detection.
    pub class: ClassId,
    /// Tentative until enough detections matched it, then confirmed for good.
    pub confirmed: bool,
    /// Confidence of its last detection.
    pub confidence: f64,
    /// Box of its last detection.
    pub detected: BoundingBox,
    /// Detections matched so far, the one that created it included.
    pub hits: u32,
    /// Frames since its last detection.
    pub since_update: u32,
    /// Frames since the detector last measured or missed it: its age under T_max (paper, ΔT).
    pub since_infer: u32,
    /// Detector frames in a row that missed it and that it survived: a confirmed object's rescues.
    pub misses: u32,
    /// Where it is, and how surely.
    pub filter: Filter,
}

impl ObjectState {
    /// A new object from the detection that no other object wanted.
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

    /// Takes the detection it was matched with.
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
