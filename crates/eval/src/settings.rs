//! Defines the settings of an evaluation.

use crate::energy_model::EnergyModel;
use crate::judge::{Classes, Interpolation};
use albireo_core::policy::{MinConfidence, Profile};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The source of the empty-scene screen's verdicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum ScreenRule {
    /// A screen that never says "empty".
    Nonempty,
    /// A screen that is always right: "empty" exactly when the frame has no stored detection. As in the published
    /// code, any number of frames in a row may be empty.
    Detections,
    /// Recorded verdicts of a real screen, from `screen/*.csv` beside the detections, under the node's limit on empty
    /// frames in a row.
    Recorded,
}

impl ScreenRule {
    /// The name on the command line and in traces.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Nonempty => "nonempty",
            Self::Detections => "detections",
            Self::Recorded => "recorded",
        }
    }
}

/// The settings of a run. The defaults are those of `albireo eval`.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The definitions that apply where the published code and the paper's text differ.
    pub profile: Profile,
    /// The source of the empty-scene screen's verdicts.
    pub screen: ScreenRule,
    /// Frames in a row that the screen may call empty before the detector runs anyway; 0 for any number.
    pub longest_empty_run: u32,
    /// Detections below this confidence are not used.
    pub confidence: f64,
    /// Boxes below this confidence are not judged, as a node with this `report.confidence` does not publish them.
    /// `None`: [`confidence`](Self::confidence) for detected boxes, half of it for predicted ones.
    pub report_confidence: Option<f64>,
    /// Whether classes are judged together.
    pub classes: Classes,
    /// How the area under the precision-recall curve is computed.
    pub interpolation: Interpolation,
    /// The folder to which the traces of all policies are written.
    pub traces: Option<PathBuf>,
    /// The number of threads; 0 for as many as the machine has.
    pub threads: usize,
    /// True to keep the frames with the most lost objects, with their boxes.
    pub keep_worst: bool,
    /// The model that projects energy and frame time, if any.
    pub energy_model: Option<EnergyModel>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            profile: Profile::Paper,
            screen: ScreenRule::Nonempty,
            longest_empty_run: 100,
            confidence: 0.5,
            report_confidence: None,
            classes: Classes::Pooled,
            interpolation: Interpolation::AllPoints,
            traces: None,
            threads: 0,
            keep_worst: false,
            energy_model: None,
        }
    }
}

impl Settings {
    /// The confidence that a box needs to be published.
    pub(crate) fn min_confidence(&self) -> MinConfidence {
        MinConfidence::new(self.report_confidence, self.confidence)
    }
}
