//! When a camera's frames are answered, and what is published: `node.answer`, `camera.answer`, `[settle]` and `[report]`.

use serde::{Deserialize, Serialize};

/// When a frame is answered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnswerTime {
    /// When the detector has answered, if it is needed: frames that come meanwhile wait or are dropped.
    #[default]
    WhenKnown,
    /// When the frame comes, by prediction; what the detector finds is published later.
    AtOnce,
}

/// The `[settle]` section of the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SettleConfig {
    /// Whether each frame is published once more, with its boxes drawn between two detector calls.
    pub enabled: bool,
    /// Longest time a frame is held back for the second of them, milliseconds.
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

/// The `[report]` section of the configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReportConfig {
    /// Least confidence of a published box, 0 to 1. By default that of the detector for detected boxes, and half of it for
    /// the others.
    pub confidence: Option<f64>,
}
