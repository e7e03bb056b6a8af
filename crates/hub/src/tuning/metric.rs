//! Defines the figures of clips that gates bound and trials compare, per node.

use super::effect::Scale;
use crate::named::named;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

named! {
    /// A metric that a gate bounds.
    pub enum Metric {
        /// Share of a clip's frames that skipped the detector.
        SkipRate = "skip_rate",
        /// Joules of a clip.
        Joules = "joules",
        /// Energy-delay product of a clip, J·ms/frame.
        Edp = "edp",
        /// 99th percentile of a clip's latencies from reception to publication, ms.
        LatencyP99 = "latency_p99",
        /// Share of a clip's frames answered from prediction because the detector was not available.
        Degraded = "degraded",
        /// Share of the detector's boxes on a clip's audited frames that were shown: against the detector, not the truth.
        Recall = "recall",
        /// Share of the boxes shown on a clip's audited frames that the detector confirms: against the detector, not the truth.
        Precision = "precision",
    }
}

impl Metric {
    /// True if a higher value is worse.
    pub(crate) const fn more_is_worse(self) -> bool {
        !matches!(self, Self::SkipRate | Self::Recall | Self::Precision)
    }

    /// The sign between a gate's metric and its bound.
    pub(crate) const fn sign(self) -> &'static str {
        if self.more_is_worse() { "<=" } else { ">=" }
    }

    /// The figures that are compared, whose names begin with its own. Measured and estimated energy are separate figures.
    pub(crate) fn figures(self) -> impl Iterator<Item = Figure> {
        Figure::ALL
            .into_iter()
            .filter(move |figure| figure.name().starts_with(self.name()))
    }
}

named! {
    /// A figure of clips. Energy that was metered over only a part of the clip is in no figure.
    pub enum Figure {
        /// Share of frames that skipped the detector.
        SkipRate = "skip_rate",
        /// Joules of clips whose energy was measured.
        JoulesMeasured = "joules_measured",
        /// Joules of clips whose energy was estimated.
        JoulesEstimated = "joules_estimated",
        /// EDP of clips whose energy was measured.
        EdpMeasured = "edp_measured",
        /// EDP of clips whose energy was estimated.
        EdpEstimated = "edp_estimated",
        /// 99th percentile of latency, ms.
        LatencyP99 = "latency_p99",
        /// Share of degraded frames.
        Degraded = "degraded",
        /// Recall against the detector.
        Recall = "recall",
        /// Precision against the detector.
        Precision = "precision",
    }
}

impl Figure {
    /// The scale of a node's change: a difference for shares, a ratio for the others.
    pub const fn scale(self) -> Scale {
        match self {
            Self::SkipRate | Self::Degraded | Self::Recall | Self::Precision => Scale::Absolute,
            _ => Scale::Relative,
        }
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

/// The figures of a node's clips in a window, each over the clips that have it.
pub type Figures = BTreeMap<Figure, Mean>;

/// A node's figures before and after a change; of a node that did not change, in the same two windows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BeforeAfter {
    /// In the baseline before the change.
    pub before: Figures,
    /// Since the change.
    pub after: Figures,
}

/// The means of one figure before and after a change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Means {
    pub(crate) before: f64,
    pub(crate) after: f64,
}

impl BeforeAfter {
    /// The means of `figure`, if both windows have at least `fewest` clips.
    pub(crate) fn means(&self, figure: Figure, fewest: u64) -> Option<Means> {
        let mean_in = |figures: &Figures| {
            let mean = figures.get(&figure)?;
            if mean.clips < fewest {
                return None;
            }
            Some(mean.sum / mean.clips as f64)
        };
        Some(Means {
            before: mean_in(&self.before)?,
            after: mean_in(&self.after)?,
        })
    }

    /// True if the node made clips before the change and none since.
    pub(crate) fn fell_silent(&self) -> bool {
        let made_clips = |figures: &Figures| figures.values().any(|mean| mean.clips > 0);
        made_clips(&self.before) && !made_clips(&self.after)
    }
}
