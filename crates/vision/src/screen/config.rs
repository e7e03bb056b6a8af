//! The `[screen]` section of the configuration.

use crate::detector::StartError;
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
    /// Which of its two outputs means "empty": 0 or 1. No setting of a node, where it is 0.
    #[serde(skip)]
    pub empty_class: usize,
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
            empty_class: 0,
            timeout_ms: 1000,
            longest_empty_run: 100,
        }
    }
}

impl ScreenConfig {
    /// Everything that is wrong and can be seen without opening a file: the key within `[screen]`, and what its
    /// value should be.
    pub fn problems(&self) -> Vec<(&'static str, String)> {
        let mut problems = Vec::new();
        if self.empty_class > 1 {
            problems.push((
                "empty_class",
                format!("must be from 0 to 1, not {}", self.empty_class),
            ));
        }
        problems
    }

    /// The first of the [`problems`](Self::problems), as an error.
    ///
    /// # Errors
    /// The first key whose value cannot be.
    pub fn check(&self) -> Result<(), StartError> {
        match self.problems().into_iter().next() {
            None => Ok(()),
            Some((key, reason)) => Err(StartError::Configuration {
                key: format!("screen.{key}"),
                reason,
            }),
        }
    }
}
