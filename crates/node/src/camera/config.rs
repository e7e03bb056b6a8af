//! Settings for answers and published boxes: `node.answer`, `camera.answer`, `[settle]`, `[report]` and `[publish]`.

use serde::{Deserialize, Serialize};

/// The time at which a frame is answered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnswerTime {
    /// When the detector has answered, if it is needed: frames that arrive until then wait or are dropped.
    #[default]
    WhenKnown,
    /// When the frame arrives, by prediction; the detector's results are published later.
    AtOnce,
}

/// The `[settle]` section.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SettleConfig {
    /// Publishes each frame again, with its boxes interpolated between two detector calls.
    pub enabled: bool,
    /// Longest time a frame is held back for the second call, milliseconds.
    pub longest_ms: u64,
}

impl Default for SettleConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            longest_ms: 2000,
        }
    }
}

/// The `[report]` section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReportConfig {
    /// Minimum confidence of a published box, 0 to 1. By default the detector's for detected boxes, and half of it for
    /// other boxes.
    pub confidence: Option<f64>,
}

/// The `[publish]` section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PublishConfig {
    /// Publishes boxes for ROS 2, too, as `vision_msgs/msg/Detection2DArray`.
    pub ros2: bool,
}
