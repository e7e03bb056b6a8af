//! The `[screen]` section of the configuration.

use super::AgnosticSettings;
use crate::detector::{LONGEST_TIMEOUT_MS, StartError};
use crate::picture::ColorOrder;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Which empty-scene screen is asked when no object is in view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScreenKind {
    /// None: the detector is asked.
    None,
    /// The trained model that `model` names.
    Model,
    /// One that learns per camera from the detector's own verdicts.
    Agnostic,
}

/// The empty-scene screen. It always runs on the CPU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScreenConfig {
    /// Which screen; without it the model if one is named, else none.
    pub kind: Option<ScreenKind>,
    /// ONNX file of a two-class model with input `[1, 3, height, width]`, values 0 to 1; empty for no
    /// screen: then the detector is asked whenever no object is active.
    pub model: Option<PathBuf>,
    /// Order of its colour planes.
    pub color_order: ColorOrder,
    /// Which of its two outputs means "empty": 0 or 1.
    pub empty_class: usize,
    /// A verdict that takes longer counts as "not empty".
    pub timeout_ms: u64,
    /// Frames in a row that may be called empty before the detector looks anyway; 0 for any number.
    pub longest_empty_run: u32,
    /// Settings of the agnostic screen.
    pub agnostic: AgnosticSettings,
}

impl Default for ScreenConfig {
    fn default() -> Self {
        Self {
            kind: None,
            model: None,
            color_order: ColorOrder::Rgb,
            empty_class: 0,
            timeout_ms: 1000,
            longest_empty_run: 100,
            agnostic: AgnosticSettings::default(),
        }
    }
}

impl ScreenConfig {
    /// Which screen is asked.
    pub fn kind(&self) -> ScreenKind {
        self.kind.unwrap_or(match self.model {
            Some(_) => ScreenKind::Model,
            None => ScreenKind::None,
        })
    }

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
        if !(1..=LONGEST_TIMEOUT_MS).contains(&self.timeout_ms) {
            problems.push((
                "timeout_ms",
                format!(
                    "must be from 1 to {LONGEST_TIMEOUT_MS}, not {}",
                    self.timeout_ms
                ),
            ));
        }
        if self.kind == Some(ScreenKind::Model) && self.model.is_none() {
            problems.push(("kind", "\"model\" needs a file in screen.model".to_owned()));
        }
        problems.extend(self.agnostic.problems());
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
