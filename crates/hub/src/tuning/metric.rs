//! The figures of clips that gates bound and trials compare, per node.

use super::effect::Scale;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use utoipa::ToSchema;

/// What a person asks about.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// Share of a clip's frames that skipped the detector.
    SkipRate,
    /// Joules of a clip.
    Joules,
    /// Energy-delay product of a clip, J·ms/frame.
    Edp,
    /// 99th percentile of a clip's latencies from reception to publication, ms.
    LatencyP99,
    /// Share of a clip's frames answered from prediction because the detector could not be had.
    Degraded,
    /// Share of a clip's frames whose detector run failed, where reports tell.
    DetectorErrors,
    /// Share of the detector's boxes on a clip's audited frames that had been shown: against the detector, not the truth.
    Recall,
    /// Share of the boxes shown on a clip's audited frames that the detector confirms: against the detector, not the truth.
    Precision,
}

impl Metric {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::SkipRate,
        Self::Joules,
        Self::Edp,
        Self::LatencyP99,
        Self::Degraded,
        Self::DetectorErrors,
        Self::Recall,
        Self::Precision,
    ];

    /// Its name in gates, messages and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SkipRate => "skip_rate",
            Self::Joules => "joules",
            Self::Edp => "edp",
            Self::LatencyP99 => "latency_p99",
            Self::Degraded => "degraded",
            Self::DetectorErrors => "detector_errors",
            Self::Recall => "recall",
            Self::Precision => "precision",
        }
    }

    /// The metric of that name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|metric| metric.name() == name)
    }

    /// Whether more of it is worse.
    pub const fn more_is_worse(self) -> bool {
        !matches!(self, Self::SkipRate | Self::Recall | Self::Precision)
    }

    /// What is compared: energy that was measured and energy that was estimated are two figures.
    pub const fn figures(self) -> &'static [Figure] {
        match self {
            Self::SkipRate => &[Figure::SkipRate],
            Self::Joules => &[Figure::JoulesMeasured, Figure::JoulesEstimated],
            Self::Edp => &[Figure::EdpMeasured, Figure::EdpEstimated],
            Self::LatencyP99 => &[Figure::LatencyP99],
            Self::Degraded => &[Figure::Degraded],
            Self::DetectorErrors => &[Figure::DetectorErrors],
            Self::Recall => &[Figure::Recall],
            Self::Precision => &[Figure::Precision],
        }
    }
}

impl fmt::Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One kind of number that clips have. Energy that was metered over a part of the clip only is in none of them.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// Share of frames that skipped the detector.
    SkipRate,
    /// Joules of clips whose energy was measured.
    JoulesMeasured,
    /// Joules of clips whose energy was estimated.
    JoulesEstimated,
    /// EDP of clips whose energy was measured.
    EdpMeasured,
    /// EDP of clips whose energy was estimated.
    EdpEstimated,
    /// 99th percentile of latency, ms.
    LatencyP99,
    /// Share of degraded frames.
    Degraded,
    /// Share of frames with a detector error.
    DetectorErrors,
    /// Recall against the detector.
    Recall,
    /// Precision against the detector.
    Precision,
}

impl Figure {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 10] = [
        Self::SkipRate,
        Self::JoulesMeasured,
        Self::JoulesEstimated,
        Self::EdpMeasured,
        Self::EdpEstimated,
        Self::LatencyP99,
        Self::Degraded,
        Self::DetectorErrors,
        Self::Recall,
        Self::Precision,
    ];

    /// How a node's change is taken: shares by their difference, all else by its ratio.
    pub const fn scale(self) -> Scale {
        match self {
            Self::JoulesMeasured
            | Self::JoulesEstimated
            | Self::EdpMeasured
            | Self::EdpEstimated
            | Self::LatencyP99 => Scale::Relative,
            _ => Scale::Absolute,
        }
    }

    /// Its name in messages and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SkipRate => "skip_rate",
            Self::JoulesMeasured => "joules_measured",
            Self::JoulesEstimated => "joules_estimated",
            Self::EdpMeasured => "edp_measured",
            Self::EdpEstimated => "edp_estimated",
            Self::LatencyP99 => "latency_p99",
            Self::Degraded => "degraded",
            Self::DetectorErrors => "detector_errors",
            Self::Recall => "recall",
            Self::Precision => "precision",
        }
    }
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The mean of one figure over a node's clips.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Mean {
    /// Clips that have the figure.
    pub clips: u64,
    /// Sum over these clips.
    pub sum: f64,
}

impl Mean {
    /// The mean, with at least `fewest` clips.
    pub fn of_at_least(self, fewest: u64) -> Option<f64> {
        (self.clips >= fewest.max(1)).then(|| self.sum / self.clips as f64)
    }
}

/// A node's clips over a window: each figure over the clips that have it.
pub type Figures = BTreeMap<Figure, Mean>;

/// A node's clips before a change and after it. For a node that was not asked to change, the same two times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BeforeAfter {
    /// Over the baseline before the change.
    pub before: Figures,
    /// Since the change.
    pub after: Figures,
}

impl BeforeAfter {
    /// Whether the node made clips before and none since.
    pub fn fell_silent(&self) -> bool {
        let clips = |figures: &Figures| figures.values().map(|mean| mean.clips).max();
        clips(&self.before) > Some(0) && clips(&self.after).unwrap_or(0) == 0
    }
}
