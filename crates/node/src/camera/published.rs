//! Selects the boxes of a frame that a camera publishes.

use serde::{Deserialize, Serialize};

/// The `[report]` section of the configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReportConfig {
    /// Least confidence of a published box, 0 to 1. By default that of the detector for detected boxes, and half of it for
    /// the others.
    pub confidence: Option<f64>,
}
