//! The `[target]` section of the configuration.

use albireo_core::target::Target;
use serde::{Deserialize, Serialize};

/// What is to be held in the place of the knob's number: at most one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TargetConfig {
    /// Recall against the detector, the lower end of its interval.
    pub recall: Option<f64>,
    /// Share of frames that skip the detector.
    pub skip_rate: Option<f64>,
    /// Time that the detector works for frames, milliseconds a second.
    pub detector_ms_per_s: Option<f64>,
    /// Mean power of the node, watts.
    pub watts: Option<f64>,
    /// Energy of the node, joules a day.
    pub joules_per_day: Option<f64>,
    /// Smallest value the knob is moved to; by default the end of what is useful.
    pub least: Option<f64>,
    /// Largest value the knob is moved to; by default the end of what is useful.
    pub most: Option<f64>,
}

impl TargetConfig {
    /// All that are set.
    pub(crate) fn all(&self) -> Vec<Target> {
        let [recall, skip_rate, detector, watts, joules] = [
            self.recall.map(Target::Recall),
            self.skip_rate.map(Target::SkipRate),
            self.detector_ms_per_s.map(Target::DetectorMsPerS),
            self.watts.map(Target::Watts),
            self.joules_per_day.map(Target::JoulesPerDay),
        ];
        [recall, skip_rate, detector, watts, joules]
            .into_iter()
            .flatten()
            .collect()
    }

    /// The one that is set.
    pub(crate) fn target(&self) -> Option<Target> {
        self.all().first().copied()
    }
}
