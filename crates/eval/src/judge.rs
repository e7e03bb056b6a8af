//! Judges boxes against the ground truth: average precision, and whether boxes keep the identity of their object.

pub(crate) mod average_precision;
mod ignored;
mod tracking;

pub use average_precision::{Accuracy, Classes, Interpolation, SHOWN_CONFIDENCE, accuracy};
pub(crate) use average_precision::{accuracy_by_class, hits};
pub(crate) use ignored::outside_ignored;
pub use tracking::{Tracking, tracking};
