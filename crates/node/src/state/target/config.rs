//! The `[target]` section of the configuration.

use albireo_core::target::Target;
use serde::{Deserialize, Serialize};

/// The target that the node holds by moving its threshold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TargetConfig {
    /// The target: `{ skip_rate = 0.5 }`. One at a time.
    pub hold: Option<Target>,
    /// Smallest value the knob is moved to; by default where accuracy costs little.
    pub least: Option<f64>,
    /// Largest value the knob is moved to; by default where accuracy costs little.
    pub most: Option<f64>,
}
