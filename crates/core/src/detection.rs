//! Detections in one picture, and the classes of a detector.

use crate::geometry::BoundingBox;
use serde::{Deserialize, Serialize};

/// A class by its index in the run's list of class names (of the model or data set).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ClassId(pub u16);

/// One detection: a box, its class and its confidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Box in normalised coordinates of the source picture.
    pub bounding_box: BoundingBox,
    /// Class, by the detector's number.
    pub class: ClassId,
    /// Confidence of the detector, 0 to 1.
    pub confidence: f64,
}

/// The seven classes of BDD100K that the paper reports.
pub const BDD100K_CLASSES: [&str; 7] = [
    "pedestrian",
    "rider",
    "car",
    "truck",
    "bus",
    "motorcycle",
    "bicycle",
];

/// Number of an object within a stream, from 0, never reused.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ObjectId(pub u64);
