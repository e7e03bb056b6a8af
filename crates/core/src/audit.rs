//! Recall and precision of skipped frames against the detector, estimated from a random sample.
//!
//! A share of the frames that were answered **without** the detector is drawn at random ([`AuditDraw`]). The detector runs
//! on them afterwards, and the boxes that were shown are compared with what it finds ([`AuditSums::add`]).
//!
//! - *Recall against the detector*: share of the detector's boxes that were shown.
//! - *Precision against the detector*: share of the shown boxes that the detector confirms.
//!
//! Neither is accuracy against the truth: a detector misses objects and reports some that are not there, and a policy that
//! keeps showing an object which the detector misses loses precision here although it may be right.
//!
//! A drawn frame that the detector had no time for is *missed*. Detectors are busy when much is going on, so what is missed
//! is not a random part of what is drawn: the intervals allow for any result on the missed frames.

mod draw;
mod rate;
mod sums;
#[cfg(test)]
mod tests;

pub use draw::AuditDraw;
pub use rate::AuditRate;
pub use sums::{AuditSquares, AuditSums};

/// Smallest intersection over union of a shown and a detected box that count as the same object.
pub(crate) const AUDIT_OVERLAP: f64 = 0.5;
