//! Begins, counts and reports clips, with their energy and energy-delay product.

mod report;
#[cfg(test)]
pub(crate) mod tests;
mod tracker;
mod travel;

pub(crate) use report::Clip;
pub(crate) use tracker::ClipTracker;

use serde::{Deserialize, Serialize};

/// The longest time that one report may cover, seconds: the limit of `clip.longest_s`.
pub const LONGEST_REPORT_S: f64 = 3600.0;

/// The `[clip]` section: when a clip ends, if the camera does not end it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClipConfig {
    /// Length of one clip of a camera that names none, seconds (BDD100K clips have 40).
    pub window_s: f64,
    /// Longest time of one report, seconds: a longer clip is reported in parts, so a power cut costs at most one part.
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
