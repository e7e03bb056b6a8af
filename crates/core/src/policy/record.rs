//! The record of one object, in the form of the golden traces.

use super::ObjectId;
use crate::detection::ClassId;
use crate::geometry::BoundingBox;
use crate::objects::ObjectState;
use serde::{Deserialize, Serialize};

/// One object after a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectRecord {
    /// Number in the stream.
    pub id: ObjectId,
    /// Class of the last detection.
    pub class: ClassId,
    /// True if the object is confirmed.
    pub confirmed: bool,
    /// Confidence of the last detection, not decayed.
    #[serde(rename = "conf")]
    pub confidence: f64,
    /// The estimated box, neither rounded nor clipped.
    #[serde(rename = "box")]
    pub bounding_box: BoundingBox,
    /// Uncertainty τ after the frame.
    pub tau: f64,
    /// Detections matched so far, including the one that created the object.
    pub hits: u32,
    /// Frames since the last detection.
    pub since_update: u32,
    /// Frames since the detector last measured or missed the object.
    pub since_infer: u32,
    /// Consecutive detector frames that missed the object.
    #[serde(rename = "rescues")]
    pub misses: u32,
}

impl From<&ObjectState> for ObjectRecord {
    fn from(state: &ObjectState) -> Self {
        Self {
            id: state.id,
            class: state.class,
            confirmed: state.confirmed,
            confidence: state.confidence,
            bounding_box: state.filter.bounding_box(),
            tau: state.filter.tau(),
            hits: state.hits,
            since_update: state.since_update,
            since_infer: state.since_infer,
            misses: state.misses,
        }
    }
}
