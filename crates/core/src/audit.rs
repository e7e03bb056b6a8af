//! What skipping costs, measured against the only reference there is in the field: the detector itself.
//!
//! A share of the frames that were answered **without** the detector is drawn at random ([`AuditDraw`]) and looked at by
//! the detector afterwards. What had been shown is compared with what the detector finds ([`AuditSums::add`]), and the
//! comparison is kept as whole numbers, so that the sums of clips, nodes and fleets add up exactly.
//!
//! - *Recall against the detector*: share of the detector's boxes that had been shown.
//! - *Precision against the detector*: share of the shown boxes that the detector confirms.
//!
//! Neither is accuracy against the truth: a detector misses objects and sees some that are not there, and a policy that
//! keeps showing an object which the detector misses loses precision here although it may be right.

mod comparison;
mod draw;
mod rate;
mod sums;
#[cfg(test)]
mod tests;

pub use draw::AuditDraw;
pub use rate::AuditRate;
pub use sums::{
    AuditSpread, AuditSums, AuditTally, BoxCounts, ByPause, BySize, ByState, SquareSums,
};

/// Least intersection over union of a shown and a detected box that are taken for the same object.
pub const AUDIT_OVERLAP: f64 = 0.5;

/// A box that no box of the other side overlaps by this much stands alone: an object that has newly appeared, or one
/// that is gone. Above it the object was known, and its box was off.
pub const AUDIT_NEAR: f64 = 0.1;

/// Share of the picture's area from which a box is medium, and large. COCO's bounds are 32² and 96² pixels in pictures of
/// about 640x480; as shares of the picture they hold at every resolution.
pub const AUDIT_SIZES: [f64; 2] = [
    (32.0 * 32.0) / (640.0 * 480.0),
    (96.0 * 96.0) / (640.0 * 480.0),
];
