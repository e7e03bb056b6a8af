//! The `[audit]` section of the configuration.

use albireo_core::audit::AuditDraw;
use serde::{Deserialize, Serialize};
use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

/// How many of the skipped frames are looked at afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AuditConfig {
    /// Share of the frames answered without the detector; 0 for no audit.
    pub share: f64,
}

/// A drawn frame that the detector had no time for in this long counts as missed. A detector that is busy for longer is
/// overloaded, and waiting on would keep pictures in memory.
pub(crate) const LONGEST_WAIT: Duration = Duration::from_secs(5);

impl Default for AuditConfig {
    fn default() -> Self {
        Self { share: 0.02 }
    }
}

impl AuditConfig {
    /// The draw of one camera. Each call gives another one: frames are counted from 0 at every start, and a camera that is
    /// always started at the same place must not have the same frames drawn each time.
    pub(crate) fn draw(&self) -> AuditDraw {
        AuditDraw::new(
            self.share,
            RandomState::new().hash_one(self.share.to_bits()),
        )
    }
}
