//! Begins, counts and reports clips, with their energy and energy-delay product.

mod latencies;
mod report;
#[cfg(test)]
pub(crate) mod tests;
mod tracker;

pub(crate) use latencies::percentile;
pub(crate) use report::Clip;
pub use report::energy_delay_product;
pub(crate) use tracker::ClipTracker;

use serde::{Deserialize, Serialize};

/// The `[clip]` section of the configuration: it says when a clip ends, where the camera does not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClipConfig {
    /// Seconds of one clip of a camera that names none (BDD100K clips have 40).
    pub window_s: f64,
    /// Most seconds of one report: a clip that lasts longer is reported in parts, so that a power cut costs at most one.
    pub longest_s: f64,
    /// Seconds without a frame after which the open clip ends.
    pub silence_s: f64,
}

impl Default for ClipConfig {
    fn default() -> Self {
        Self {
            window_s: 40.0,
            longest_s: 300.0,
            silence_s: 5.0,
        }
    }
}
