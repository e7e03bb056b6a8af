//! What the audit of a node has found: sums in a clip's report, figures for whoever reads them.

use albireo_core::audit::{AuditRate, AuditSums, AuditTally};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The audit's part of a clip report: what became known of skipped frames between the report before and this one. A
/// frame at the end of a clip may be in the next one's.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct AuditReport {
    /// Share of the skipped frames that is drawn.
    pub share: f64,
    /// Times the detector looked for the audit; in none of the frame states and not in the skip rate.
    pub calls: u64,
    /// Detector time of these, microseconds.
    pub detector_us: u64,
    /// Estimate of what that time added, joules, which are among the clip's: the watts that a running detector adds on this
    /// machine times `detector_us`. Absent while it is not known what it adds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joules: Option<f64>,
    /// What was compared.
    #[serde(skip_serializing_if = "AuditSums::is_empty")]
    pub sums: AuditSums,
}

/// A group of comparisons in figures. All are against the detector and not against the truth: a policy that keeps showing
/// an object which the detector misses loses precision here although it may be right.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AuditGroup {
    /// Frame state, length of the pause in frames, or size of the boxes; `all` for all of them.
    pub name: String,
    /// Frames that were compared; 0 where boxes are grouped by size.
    pub frames: u64,
    /// Boxes that the detector found.
    pub detected: u64,
    /// Boxes that had been shown.
    pub shown: u64,
    /// Share of the detector's boxes that had been shown; absent when it found none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recall: Option<AuditRate>,
    /// Share of the shown boxes that the detector confirms; absent when none was shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub precision: Option<AuditRate>,
    /// Mean intersection over union of the pairs; absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_overlap: Option<f64>,
    /// Boxes of the detector with nothing shown near them: objects that have newly appeared.
    pub appeared: u64,
    /// Shown boxes with nothing of the detector's near them: objects that are gone, or that the detector misses.
    pub gone: u64,
    /// Pairs of one class.
    pub same_class: u64,
}

/// What an audit has found, in figures with intervals at 95 %.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AuditFigures {
    /// Skipped frames that were drawn.
    pub drawn: u64,
    /// Those of them that the detector could not look at in time.
    pub missed: u64,
    /// Times the detector looked for the audit.
    pub calls: u64,
    /// Detector time of these, seconds.
    pub detector_s: f64,
    /// All comparisons.
    pub all: AuditGroup,
    /// By the state of the frame.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_state: Vec<AuditGroup>,
    /// By the number of frames since the detector last looked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_pause: Vec<AuditGroup>,
    /// By the size of the box.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_size: Vec<AuditGroup>,
}

fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn rounded_rate(rate: AuditRate) -> AuditRate {
    AuditRate {
        rate: rounded(rate.rate),
        low: rounded(rate.low),
        high: rounded(rate.high),
        boxes: rate.boxes,
        independent: (rate.independent * 10.0).round() / 10.0,
    }
}

impl AuditGroup {
    fn new(name: &str, sums: &AuditSums, tally: &AuditTally) -> Self {
        Self {
            name: name.to_owned(),
            frames: tally.frames,
            detected: tally.detected.boxes,
            shown: tally.shown.boxes,
            recall: sums.recall_of(tally).map(rounded_rate),
            precision: sums.precision_of(tally).map(rounded_rate),
            mean_overlap: tally.mean_overlap().map(rounded),
            appeared: tally.detected.alone,
            gone: tally.shown.alone,
            same_class: tally.same_class,
        }
    }
}

impl AuditFigures {
    /// The figures of `sums` over everything, for `calls` of the detector that took `detector_us` microseconds.
    pub fn new(sums: &AuditSums, calls: u64, detector_us: u64) -> Self {
        Self {
            drawn: sums.drawn(),
            missed: sums.missed,
            calls,
            detector_s: (detector_us / 1000) as f64 / 1e3,
            all: AuditGroup::new("all", sums, &sums.total()),
            ..Self::default()
        }
    }

    /// The same with the groups that have anything in them.
    pub fn with_groups(sums: &AuditSums, calls: u64, detector_us: u64) -> Self {
        let groups = |groups: &[(&str, &AuditTally)]| {
            let some = groups.iter().filter(|(_, tally)| !tally.is_empty());
            some.map(|(name, tally)| AuditGroup::new(name, sums, tally))
                .collect()
        };
        let states = [("E", &sums.by_state.e), ("P", &sums.by_state.p)];
        Self {
            by_state: groups(&states),
            by_pause: groups(&sums.by_pause.groups()),
            by_size: groups(&sums.by_size.groups()),
            ..Self::new(sums, calls, detector_us)
        }
    }
}
