//! The results of a node's audit: sums for clip reports and human-readable rates.

use albireo_core::audit::{AuditRate, AuditSums};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// The audit part of a clip report: results for skipped frames since the previous report. A frame at the end of a clip
/// may be counted in the next report.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct AuditReport {
    /// Share of skipped frames drawn for the audit.
    pub share: f64,
    /// Detector calls for the audit; included in neither the frame states nor the skip rate.
    pub calls: u64,
    /// Detector time of these calls, microseconds.
    pub detector_us: u64,
    /// Estimated energy of these calls, joules, included in the clip's energy: the watts that a running detector adds
    /// on this machine times `detector_us`. Absent while those watts are unknown.
    pub joules: Option<f64>,
    /// Counts of compared and missed frames.
    #[serde(skip_serializing_if = "AuditSums::is_empty")]
    pub sums: AuditSums,
}

impl AuditReport {
    /// Adds the counts of `more`. `share` stays, because it is configured and not counted; so does `joules`, which is set
    /// once, from `detector_us`, when the clip is reported.
    pub fn merge(&mut self, more: &Self) {
        self.calls = self.calls.saturating_add(more.calls);
        self.detector_us = self.detector_us.saturating_add(more.detector_us);
        self.sums.merge(&more.sums);
    }

    /// Returns the human-readable figures.
    pub fn figures(&self) -> AuditFigures {
        AuditFigures::new(&self.sums, self.calls, self.detector_us)
    }
}

/// The results of an audit, with 95 % intervals that account for missed frames. The reference is the detector, not the
/// truth: a policy that keeps showing an object that the detector misses loses precision here although it may be right.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AuditFigures {
    /// Skipped frames drawn for the audit.
    pub drawn: u64,
    /// Drawn frames that the detector had no time for.
    pub missed: u64,
    /// Detector calls for the audit.
    pub calls: u64,
    /// Detector time of these calls, seconds.
    pub detector_s: f64,
    /// Boxes that the detector found on the compared frames.
    pub detected: u64,
    /// Boxes shown on the compared frames.
    pub shown: u64,
    /// Share of the detector's boxes that were shown; absent if it found none.
    pub recall: Option<AuditRate>,
    /// Share of the shown boxes that the detector confirms; absent if none was shown.
    pub precision: Option<AuditRate>,
}

impl AuditFigures {
    /// Returns the figures for `sums` and `calls` detector calls that took `detector_us` microseconds.
    pub fn new(sums: &AuditSums, calls: u64, detector_us: u64) -> Self {
        // Whole milliseconds are exact enough for a sum over many calls.
        let detector_ms = detector_us / 1000;
        Self {
            drawn: sums.drawn(),
            missed: sums.missed,
            calls,
            detector_s: detector_ms as f64 / 1e3,
            detected: sums.detected,
            shown: sums.shown,
            recall: sums.recall().map(rounded),
            precision: sums.precision().map(rounded),
        }
    }
}

/// Rounds the shares to four decimals and the independent boxes to one: an audit of some thousand boxes is no more exact.
fn rounded(rate: AuditRate) -> AuditRate {
    let rounded_share = |share: f64| (share * 1e4).round() / 1e4;
    AuditRate {
        rate: rounded_share(rate.rate),
        low: rounded_share(rate.low),
        high: rounded_share(rate.high),
        boxes: rate.boxes,
        independent: (rate.independent * 10.0).round() / 10.0,
    }
}
