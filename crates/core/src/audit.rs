//! Recall and precision of skipped frames against the detector, estimated from a random sample.
//!
//! A share of the frames answered **without** the detector is drawn at random ([`AuditDraw`]). The detector runs on
//! them afterwards, and the boxes shown are compared with its detections ([`AuditSums::add`]).
//!
//! - *Recall against the detector*: share of the detector's boxes that were shown.
//! - *Precision against the detector*: share of the shown boxes that the detector confirms.
//!
//! Neither is accuracy against ground truth: a detector misses objects and reports false ones, and a policy that keeps
//! showing an object that the detector misses loses precision here although it may be right.
//!
//! A drawn frame that the detector had no time for is *missed*. Detectors are busy in busy scenes, so missed frames are
//! not a random part of the drawn ones: the intervals allow for any result on the missed frames.

mod draw;
mod rate;
mod sums;
#[cfg(test)]
pub(crate) mod tests;

pub use draw::AuditDraw;
pub use rate::AuditRate;
pub use sums::{AuditSquares, AuditSums};

/// Smallest intersection over union at which a shown and a detected box count as the same object.
pub(crate) const AUDIT_OVERLAP: f64 = 0.5;
