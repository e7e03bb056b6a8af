//! The `[screen]` section of the configuration.

use crate::picture::ColorOrder;
use albireo_core::policy::EmptyRoad;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The empty-scene screen: a pause on an empty road, and a model, which always runs on the CPU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScreenConfig {
    /// Seconds from one look at an empty road to the next; 0 looks at every frame. Works without a model, too.
    pub pause_s: f64,
    /// Seconds without a detection after which the road is empty.
    pub after_s: f64,
    /// Seconds from one look at a picture without news to the next; 0 compares no pictures.
    pub still_s: f64,
    /// The ONNX file of a two-class model with input `[1, 3, height, width]`, values 0 to 1. If empty, there is no
    /// model: the detector is asked whenever no object is active, except in a pause.
    pub model: Option<PathBuf>,
    /// The order of its colour planes.
    pub color_order: ColorOrder,
    /// True if the second of its two outputs means "empty", not the first. Not a node setting: on a node it is the
    /// first.
    #[serde(skip)]
    pub empty_is_second: bool,
    /// A verdict that takes longer counts as "not empty". Not a node setting.
    #[serde(skip)]
    pub timeout_ms: u64,
    /// The number of consecutive frames that may be called empty before the detector runs anyway; 0 for no limit. Not a
    /// node setting.
    #[serde(skip)]
    pub longest_empty_run: u32,
}

impl Default for ScreenConfig {
    fn default() -> Self {
        let EmptyRoad {
            pause_s,
            after_s,
            still_s,
        } = EmptyRoad::default();
        Self {
            pause_s,
            after_s,
            still_s,
            model: None,
            color_order: ColorOrder::Rgb,
            empty_is_second: false,
            timeout_ms: 1000,
            longest_empty_run: 100,
        }
    }
}

impl ScreenConfig {
    /// The pause on an empty road.
    pub fn empty_road(&self) -> EmptyRoad {
        EmptyRoad {
            pause_s: self.pause_s,
            after_s: self.after_s,
            still_s: self.still_s,
        }
    }
}
