//! Computes means over the rounds and changes against the first variant, with confidence intervals.

use super::run::{Comparison, Run};
use crate::statistics::half_interval;
use albireo_wire::EnergyQuality;
use serde::Serialize;

/// A figure of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// Energy of the clip, joules; only if power samples cover the whole run.
    Joules,
    /// Energy-delay product, J·ms/frame.
    Edp,
    /// CPU time of the process, seconds.
    CpuSeconds,
    /// Mean time of a frame until its answer, milliseconds: [`Run::frame_ms`].
    FrameMilliseconds,
    /// The number of detector runs.
    DetectorCalls,
    /// Share of frames that skipped the detector, 0 to 1.
    SkipRate,
    /// The number of frames that were not processed.
    Dropped,
    /// Average precision of the boxes against the detector's own.
    Ap50,
    /// Precision of the boxes against the detector's own.
    Precision,
    /// Recall of the boxes against the detector's own.
    Recall,
    /// Average precision of the boxes by ground truth.
    TruthAp50,
    /// Precision of the boxes by ground truth.
    TruthPrecision,
    /// Recall of the boxes by ground truth.
    TruthRecall,
}

impl Figure {
    /// All figures.
    const ALL: [Self; 13] = [
        Self::Joules,
        Self::Edp,
        Self::CpuSeconds,
        Self::FrameMilliseconds,
        Self::DetectorCalls,
        Self::SkipRate,
        Self::Dropped,
        Self::Ap50,
        Self::Precision,
        Self::Recall,
        Self::TruthAp50,
        Self::TruthPrecision,
        Self::TruthRecall,
    ];

    /// The figure's value in a run, if the run has one.
    pub(super) fn of(self, run: &Run) -> Option<f64> {
        let report = &run.report;
        match self {
            Self::Joules => report.energy.whole_joules(),
            Self::Edp if report.energy.is_whole() => report.energy.edp,
            Self::Edp => None,
            Self::CpuSeconds => Some(run.cpu_s),
            Self::FrameMilliseconds => run.frame_ms,
            Self::DetectorCalls => Some(report.detector_latency_ms.count as f64),
            Self::SkipRate => (report.frames > 0).then_some(report.skip_rate),
            Self::Dropped => Some(report.dropped.total() as f64),
            Self::Ap50 => run.agreement.map(|found| found.ap50),
            Self::Precision => run.agreement.map(|found| found.precision),
            Self::Recall => run.agreement.map(|found| found.recall),
            Self::TruthAp50 => run.by_truth.map(|found| found.ap50),
            Self::TruthPrecision => run.by_truth.map(|found| found.precision),
            Self::TruthRecall => run.by_truth.map(|found| found.recall),
        }
    }
}

/// A mean over the rounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mean {
    /// Arithmetic mean.
    pub mean: f64,
    /// Half the width of its 95 % confidence interval (Student's t over the rounds); `None` with one round.
    pub half: Option<f64>,
    /// Number of rounds.
    pub rounds: usize,
}

impl Mean {
    /// The mean of `values`; `None` if there are none, or one is not finite.
    pub(super) fn of(values: &[f64]) -> Option<Self> {
        let rounds = values.len();
        if rounds == 0 || values.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let mean = values.iter().sum::<f64>() / rounds as f64;
        // For equal values the interval is only a rounding error, and for zeros it is undefined: both become 0.
        let half = match half_interval(values) {
            Some(half) if half > 1e-12 * mean.abs() => Some(half),
            _ if rounds > 1 => Some(0.0),
            _ => None,
        };
        Some(Self { mean, half, rounds })
    }
}

/// A change against the first variant: the mean of the differences within a round, in percent of the first
/// variant's mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Change {
    /// Percent; negative if it is less.
    pub percent: f64,
    /// Half the width of its 95 % confidence interval, percent; `None` with one round.
    pub half: Option<f64>,
}

/// The figures of one variant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VariantSummary {
    /// The variant's label.
    pub policy: String,
    /// The means of the figures that every run has.
    pub means: Vec<(Figure, Mean)>,
    /// Changes against the first variant; empty for the first.
    pub changes: Vec<(Figure, Change)>,
}

impl VariantSummary {
    /// The mean of a figure.
    pub(super) fn mean(&self, figure: Figure) -> Option<Mean> {
        self.means.iter().find(|(known, _)| *known == figure).map(|(_, mean)| *mean)
    }

    /// The change of a figure.
    pub(super) fn change(&self, figure: Figure) -> Option<Change> {
        self.changes
            .iter()
            .find(|(known, _)| *known == figure)
            .map(|(_, change)| *change)
    }
}

/// The results of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The quality of the energy figures.
    pub energy: EnergyQuality,
    /// The source of the energy figures, as in clip reports: `rapl`, `tegrastats`, …
    pub energy_source: String,
    /// The smallest share of a run's time that power samples cover.
    pub coverage: f64,
    /// The number of complete rounds.
    pub rounds: usize,
    /// The highest CPU time of reading the meter, as a share of one core; `None` if no meter is read.
    pub meter_share_of_core: Option<f64>,
    /// The number of runs in which the board reported throttled clocks.
    pub throttled_runs: usize,
    /// The power modes in which runs were played.
    pub power_modes: Vec<String>,
    /// One entry per variant.
    pub policies: Vec<VariantSummary>,
}

/// Summarises a comparison.
pub fn summarise(comparison: &Comparison) -> Summary {
    let of_variant = |variant: usize| {
        let mut runs: Vec<_> =
            comparison.runs.iter().filter(|run| run.variant == variant).collect();
        runs.sort_by_key(|run| run.round);
        runs
    };
    let values = |variant: usize, figure: Figure| -> Option<Vec<f64>> {
        of_variant(variant).into_iter().map(|run| figure.of(run)).collect()
    };
    let mut policies = Vec::with_capacity(comparison.policies.len());
    for (variant, policy) in comparison.policies.iter().enumerate() {
        let mut summary = VariantSummary {
            policy: policy.clone(),
            means: Vec::new(),
            changes: Vec::new(),
        };
        for figure in Figure::ALL {
            let Some(own) = values(variant, figure) else {
                continue;
            };
            if let Some(mean) = Mean::of(&own) {
                summary.means.push((figure, mean));
            }
            // Changes are against the first variant.
            if variant > 0
                && let Some(first) = values(0, figure)
                && let Some(change) = change(&first, &own)
            {
                summary.changes.push((figure, change));
            }
        }
        policies.push(summary);
    }
    let runs = &comparison.runs;
    let mut power_modes: Vec<String> = runs
        .iter()
        .filter_map(|run| run.report.board.as_ref()?.power_mode.clone())
        .collect();
    power_modes.sort();
    power_modes.dedup();
    Summary {
        energy: quality(runs),
        energy_source: runs.first().map(|run| run.report.energy.source.clone()).unwrap_or_default(),
        coverage: runs.iter().map(|run| run.report.energy.coverage).fold(1.0, f64::min),
        rounds: runs.iter().map(|run| run.round + 1).max().unwrap_or(0),
        meter_share_of_core: runs
            .iter()
            .filter(|run| run.report.energy.samples > 0)
            .map(|run| run.meter_share_of_core)
            .reduce(f64::max),
        throttled_runs: runs
            .iter()
            .filter(|run| {
                let board = run.report.board.as_ref();
                board.is_some_and(|board| board.throttled == Some(true))
            })
            .count(),
        power_modes,
        policies,
    }
}

/// Computes the change from `first` to `other`, round by round.
fn change(first: &[f64], other: &[f64]) -> Option<Change> {
    let differences: Vec<f64> = other.iter().zip(first).map(|(a, b)| a - b).collect();
    let mean = Mean::of(&differences)?;
    let base = Mean::of(first)?.mean;
    if base == 0.0 {
        return None;
    }
    let percent = |value: f64| value / base.abs() * 100.0;
    Some(Change {
        percent: percent(mean.mean),
        half: mean.half.map(percent),
    })
}

/// Returns the least reliable quality of all runs: one estimate among measurements makes the whole an estimate.
fn quality(runs: &[Run]) -> EnergyQuality {
    let quality_of = |run: &Run| match run.report.energy.joules {
        Some(_) => run.report.energy.quality,
        None => EnergyQuality::Unavailable,
    };
    // They are ordered from the most to the least reliable.
    runs.iter().map(quality_of).max().unwrap_or_default()
}

#[cfg(test)]
pub(super) mod tests;
