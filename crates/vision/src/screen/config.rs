//! The `[screen]` section of the configuration.

use crate::picture::ColorOrder;
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
    /// Whether the second of its two outputs means "empty", and not the first. No setting of a node, where it is the
    /// first.
    #[serde(skip)]
    pub empty_is_second: bool,
    /// A verdict that takes longer counts as "not empty". No setting of a node.
    #[serde(skip)]
    pub timeout_ms: u64,
    /// Frames in a row that may be called empty before the detector runs anyway; 0 for any number. No
    /// setting of a node.
    #[serde(skip)]
    pub longest_empty_run: u32,
}

impl Default for ScreenConfig {
    fn default() -> Self {
        Self {
            model: None,
            color_order: ColorOrder::Rgb,
            empty_is_second: false,
            timeout_ms: 1000,
            longest_empty_run: 100,
        }
    }
}
