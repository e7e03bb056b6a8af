//! Judges boxes against the ground truth: average precision, whether boxes keep the identity of their object, and how
//! late objects are found.

mod assignment;
pub(crate) mod average_precision;
mod frame_matching;
mod ignored;
mod newcomers;
mod tracking;
mod truth;

pub use average_precision::{Accuracy, Classes, Interpolation, SHOWN_CONFIDENCE, accuracy};
pub(crate) use average_precision::{Matches, accuracy_by_class, hits};
pub use newcomers::{MIN_HEIGHT, Newcomers, newcomers};
pub use tracking::{Tracking, tracking};
pub(crate) use truth::only_unlabelled;
pub use truth::{Ignored, Mark, Truth, unlabelled};
