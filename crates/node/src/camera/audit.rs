//! The audit of a camera: a share of the frames that its policy answered without the detector is looked at by the
//! detector afterwards, when that has nothing else to do, and what was shown is compared with what it finds.
//!
//! It changes nothing: a frame is drawn by its number after its answer is out, and what the detector then finds reaches
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

/// How many of the skipped frames are looked at afterwards: the `[audit]` section of the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AuditConfig {
    /// Share of the frames answered without the detector; 0 for no audit.
    pub share: f64,
}

impl Default for AuditConfig {
    fn default() -> Self {
        Self { share: 0.02 }
    }
}

impl AuditConfig {
    /// The draw of one camera. Each call gives another one: frames are counted from 0 at every start, and a camera that is
    /// always started at the same place must not have the same frames drawn each time.
    fn draw(self) -> AuditDraw {
        AuditDraw::new(
            self.share,
            RandomState::new().hash_one(self.share.to_bits()),
        )
    }
}
