//! The `[screen]` section of the configuration.

use crate::frame::ColorOrder;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The empty-scene screen. It always runs on the CPU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScreenConfig {
    /// ONNX file of a two-class model with input `[1, 3, height, width]`, values 0 to 1; empty for no
    /// screen: then the detector is asked whenever no object is active.
    pub model: Option<PathBuf>,
    /// Order of its colour planes.
    pub color_order: ColorOrder,
    /// Which of its two outputs means "empty": 0 or 1.
    pub empty_class: usize,
    /// A verdict that takes longer counts as "not empty".
    pub timeout_ms: u64,
}

impl Default for ScreenConfig {
    fn default() -> Self {
        Self {
            model: None,
            color_order: ColorOrder::Rgb,
            empty_class: 0,
            timeout_ms: 1000,
        }
    }
}
