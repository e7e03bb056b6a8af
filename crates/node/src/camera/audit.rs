//! The audit of a camera: the idle detector examines a sample of the frames that the policy answered without it, and
//! the published boxes are compared with its results.
//!
//! It changes nothing: a frame is drawn by its number after its answer is published, and the detector's results reach
//! neither the policy nor the screen.

mod frames;
mod task;
#[cfg(test)]
mod tests;

pub(crate) use frames::{CameraAudit, DrawnFrame};
pub(crate) use task::Auditor;

use albireo_core::audit::AuditDraw;
use serde::{Deserialize, Serialize};
use std::hash::{BuildHasher, RandomState};

/// The `[audit]` section: the share of skipped frames that is examined afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AuditConfig {
    /// Share of the frames answered without the detector; 0 disables the audit.
    pub share: f64,
}

impl Default for AuditConfig {
    fn default() -> Self {
        Self { share: 0.02 }
    }
}

impl AuditConfig {
    /// Creates the draw of one camera. Each call returns a different one: frames are counted from 0 at every start, and
    /// a camera that always starts at the same place must not have the same frames drawn each time.
    fn draw(self) -> AuditDraw {
        AuditDraw::new(
            self.share,
            RandomState::new().hash_one(self.share.to_bits()),
        )
    }
}
