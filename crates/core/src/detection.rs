//! What a detector finds in one picture, and the classes it may name.

use crate::geometry::BoundingBox;
use serde::{Deserialize, Serialize};

/// A class by its number in the list of class names that belongs to the run (model, data set).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ClassId(pub u16);

/// One detection: a box, its class and its confidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Where, in normalised coordinates of the source picture.
    pub bounding_box: BoundingBox,
    /// Its class, by the detector's number.
    pub class: ClassId,
    /// How sure the detector is, 0 to 1.
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

/// Number of an object within a stream, from 0, never used twice.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ObjectId(pub u64);
