//! The results of a node's audit: sums in a clip report, rates for people.

use albireo_core::audit::{AuditRate, AuditSums};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// The audit's part of a clip report: results for skipped frames since the previous report. A frame at the end of a clip
/// may be counted in the next report.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct AuditReport {
    /// Share of the skipped frames that is drawn.
    pub share: f64,
    /// Detector calls for the audit; in none of the frame states and not in the skip rate.
    pub calls: u64,
    /// Detector time of these, microseconds.
    pub detector_us: u64,
    /// Estimate of what that time added, joules, which are among the clip's: the watts that a running detector adds on this
    /// machine times `detector_us`. Absent while it is not known what it adds.
    pub joules: Option<f64>,
    /// What was compared and what was missed.
    #[serde(skip_serializing_if = "AuditSums::is_empty")]
    pub sums: AuditSums,
}

impl AuditReport {
    /// Adds the other's counts.
    pub fn merge(&mut self, more: &Self) {
        self.calls = self.calls.saturating_add(more.calls);
        self.detector_us = self.detector_us.saturating_add(more.detector_us);
        self.sums.merge(&more.sums);
    }

    /// In figures.
    pub fn figures(&self) -> AuditFigures {
        AuditFigures::new(&self.sums, self.calls, self.detector_us)
    }
}

/// The results of an audit, with 95 % intervals that include the missed frames. The reference is the detector, not the
/// truth: a policy that keeps showing an object which the detector misses loses precision here although it may
/// be right.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AuditFigures {
    /// Skipped frames that were drawn.
    pub drawn: u64,
    /// Those of them that the detector had no time for.
    pub missed: u64,
    /// Detector calls for the audit.
    pub calls: u64,
    /// Detector time of these, seconds.
    pub detector_s: f64,
    /// Boxes that the detector found on the compared frames.
    pub detected: u64,
    /// Boxes that were shown on them.
    pub shown: u64,
    /// Share of the detector's boxes that were shown; absent when it found none.
    pub recall: Option<AuditRate>,
    /// Share of the shown boxes that the detector confirms; absent when none was shown.
    pub precision: Option<AuditRate>,
}

impl AuditFigures {
    /// The figures of `sums`, for `calls` of the detector that took `detector_us` microseconds.
    pub fn new(sums: &AuditSums, calls: u64, detector_us: u64) -> Self {
        Self {
            drawn: sums.drawn(),
            missed: sums.missed,
            calls,
            detector_s: (detector_us / 1000) as f64 / 1e3,
            detected: sums.detected,
            shown: sums.shown,
            recall: sums.recall().map(rounded),
            precision: sums.precision().map(rounded),
        }
    }
}

/// Rounded to the useful digits.
fn rounded(rate: AuditRate) -> AuditRate {
    let share = |value: f64| (value * 1e4).round() / 1e4;
    AuditRate {
        rate: share(rate.rate),
        low: share(rate.low),
        high: share(rate.high),
        boxes: rate.boxes,
        independent: (rate.independent * 10.0).round() / 10.0,
    }
}
