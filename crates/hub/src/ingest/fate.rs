//! Decides what becomes of a received report, and what the node is told and counted for it. All of it is pure.

use super::clip::Clip;
use super::counters::IngestCounts;
use super::decode::{Received, Rejected};
use super::plan::{Doubt, Seen};
use super::tables::{MOST_CAMERA_NAMES, ReportCountsRow, ReportKey};
use albireo_wire::{RefusedReport, ReportAnswer};
use serde_json::{Value, json};

/// Most reports that count as missing in one gap, and most of a node: more than a node makes in a year. A number that one node
/// invents must not be the fleet's figure.
const LARGEST_GAP: u64 = 1_000_000;
const MOST_MISSING: u64 = 32 * LARGEST_GAP;

/// What the database knows of a report's identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Identity {
    /// It is new, and was noted for this group.
    New,
    /// It was stored before, or earlier in this group.
    Known,
    /// It was new, and a report with it was refused earlier in this group.
    Refused,
}

/// What becomes of a report.
#[derive(Debug, PartialEq)]
pub(super) enum Fate<'a> {
    /// It is stored under this key.
    Stored(ReportKey, &'a Clip),
    /// It was stored before.
    Again,
    /// It is refused for this reason: nobody knows whether it was stored before. If its identity was noted, that is to be
    /// forgotten.
    TooOld {
        reason: &'a str,
        noted: Option<ReportKey>,
    },
    /// It is set aside for this reason.
    Invalid { reason: String },
}

impl<'a> Fate<'a> {
    /// Decides on a report with a doubt that its node's running counts did not clear, if there is one. `has_place` says
    /// whether the node may have that camera.
    pub(super) fn of(
        report: &'a Received,
        identity: Identity,
        doubt: Option<&'a Doubt>,
        has_place: impl Fn(&str) -> bool,
    ) -> Self {
        let (key, clip) = match &report.content {
            Ok((key, clip)) => (*key, clip),
            Err(Rejected::TooOld { reason }) => {
                return Self::TooOld {
                    reason,
                    noted: None,
                };
            }
            Err(Rejected::Invalid { reason }) => {
                return Self::Invalid {
                    reason: reason.clone(),
                };
            }
        };
        // First of all: a report that was stored is acknowledged, whatever else is wrong with it now.
        if identity == Identity::Known {
            return Self::Again;
        }
        if let Some(doubt) = doubt {
            return Self::TooOld {
                reason: &doubt.reason,
                noted: Some(key),
            };
        }
        if identity == Identity::Refused {
            return Self::Again;
        }
        if !has_place(&clip.camera) {
            return Self::Invalid {
                reason: format!(
                    "the node has had cameras under {MOST_CAMERA_NAMES} names: give its cameras earlier names, or the \
                     node another one"
                ),
            };
        }
        Self::Stored(key, clip)
    }

    /// The reason that the node is told, if the report is not stored.
    fn refusal(&self) -> Option<&str> {
        match self {
            Self::Stored(..) | Self::Again => None,
            Self::TooOld { reason, .. } => Some(reason),
            Self::Invalid { reason } => Some(reason),
        }
    }
}

/// An event of the node of a batch.
#[derive(Debug, PartialEq)]
pub(super) struct BatchEvent {
    pub(super) kind: &'static str,
    pub(super) detail: Value,
}

/// What the reports of one batch add up to.
#[derive(Debug, Default)]
pub(super) struct BatchResult {
    pub(super) answer: ReportAnswer,
    pub(super) counts: IngestCounts,
    pub(super) events: Vec<BatchEvent>,
    /// The reason of the first report that is too old.
    too_old: Option<String>,
}

impl BatchResult {
    /// Counts a report, refuses it where it is not stored, and else follows the running count of its node.
    pub(super) fn add(&mut self, report: &Received, fate: &Fate<'_>, node: &mut ReportCountsRow) {
        match fate {
            Fate::Stored(_, clip) => {
                self.counts += clip.row.counted();
                self.counts.clock_off += u64::from(!clip.is_clock_believed);
                node.totals.stored += 1;
            }
            Fate::Again => self.counts.again += 1,
            Fate::TooOld { reason, .. } => {
                self.counts.too_old += 1;
                node.totals.refused += 1;
                if self.too_old.is_none() {
                    self.too_old = Some((*reason).to_owned());
                }
            }
            Fate::Invalid { .. } => {
                self.counts.set_aside += 1;
                node.totals.set_aside += 1;
            }
        }
        if let Some(reason) = fate.refusal() {
            if let Some(id) = report.id {
                let reason = reason.to_owned();
                self.answer.refused.push(RefusedReport { id, reason });
            }
            // Its running count is not followed: a report that is not stored counts as missing.
            return;
        }
        if let Some(count) = report.count {
            let is_new = matches!(fate, Fate::Stored(..));
            let seen = node.counts.see(count, is_new);
            self.follow(seen, count, node);
        }
    }

    fn follow(&mut self, seen: Seen, count: u64, node: &mut ReportCountsRow) {
        match seen {
            Seen::Expected => {}
            Seen::Gap { first, last } => {
                let missing = (last - first + 1).min(LARGEST_GAP);
                self.counts.missing += missing;
                let detail = json!({ "first": first, "last": last, "missing": missing });
                self.note("gap", detail);
            }
            Seen::Reset => {
                self.counts.resets += 1;
                node.totals.resets += 1;
                self.note("reset", json!({ "count": count }));
            }
        }
    }

    fn note(&mut self, kind: &'static str, detail: Value) {
        self.events.push(BatchEvent { kind, detail });
    }

    /// Ends the batch, received at `now_ms`: what concerns all of its reports.
    pub(super) fn end(&mut self, node: &mut ReportCountsRow, now_ms: i64) {
        if let Some(reason) = self.too_old.take() {
            let detail = json!({ "reports": self.counts.too_old, "reason": reason });
            self.note("refused", detail);
        }
        if self.counts.set_aside > 0 {
            self.note("set_aside", json!({ "reports": self.counts.set_aside }));
        }
        if self.counts.clock_off > 0 {
            self.note("clock_off", json!({ "clips": self.counts.clock_off }));
        }
        node.totals.last_ms = now_ms.max(node.totals.last_ms);
        node.totals.missing = node.counts.missing().min(MOST_MISSING);
        self.answer.missing = node.counts.wanted().to_vec();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::plan::Present;
    use crate::ingest::tables::ReportCounts;
    use albireo_wire::ClipReport;
    use uuid::Uuid;

    const NOW_MS: i64 = 1_795_000_000_000;

    fn clip() -> Clip {
        let times = json!({"count": 9, "mean": 5.0, "p50": 5.0, "p95": 6.0, "p99": 7.0});
        let report = json!({
            "v": 1, "id": Uuid::nil(), "count": 1, "node": "car-1", "camera": "front", "clip": "w", "ended_by": "window",
            "started_ns": NOW_MS.unsigned_abs() * 1_000_000, "duration_s": 40.0, "frames": 9,
            "states": {"E": 0, "P": 3, "E+I": 0, "I": 6, "AI": 0}, "skip_rate": 3.0 / 9.0, "degraded_frames": 1,
            "dropped": {}, "policy": "albireo", "threshold_changes": [], "model": "m", "provider": "cpu",
            "total_latency_ms": times, "detector_latency_ms": times,
            "energy": {
                "joules": 10.0, "node_joules": 10.0, "quality": "measured", "source": "rapl",
                "total_from": "input_rail", "samples": 4, "coverage": 1.0, "domains": [],
            },
        });
        let report: ClipReport = serde_json::from_value(report).unwrap();
        let present = Present {
            hub_ms: NOW_MS,
            node_ms: NOW_MS,
        };
        crate::ingest::clip::clip(&report, present, None).unwrap()
    }

    fn received(content: Result<(ReportKey, Box<Clip>), Rejected>, count: u64) -> Received {
        Received {
            id: Some(Uuid::nil()),
            count: Some(count),
            content,
            doubt: None,
        }
    }

    fn stored(count: u64) -> Received {
        let key = ReportKey {
            day: 1,
            id: Uuid::nil(),
            own_day: 1,
        };
        received(Ok((key, Box::new(clip()))), count)
    }

    fn too_old() -> Received {
        let reason = "a reason".to_owned();
        received(Err(Rejected::TooOld { reason }), 1)
    }

    fn invalid() -> Received {
        let rejected = Rejected::Invalid {
            reason: "a reason".to_owned(),
        };
        received(Err(rejected), 1)
    }

    /// The fate of a report without a doubt, whose node may have its camera.
    fn fate(report: &Received, identity: Identity) -> Fate<'_> {
        Fate::of(report, identity, None, |_| true)
    }

    fn node() -> ReportCountsRow {
        ReportCountsRow {
            name: "car-1".to_owned(),
            node_id: 1,
            cameras: 1,
            totals: ReportCounts::default(),
            counts: Default::default(),
        }
    }

    #[test]
    fn the_fate_of_a_report_depends_on_its_content_its_identity_and_its_camera() {
        use Identity::{Known, New, Refused};
        let given = stored(1);
        let doubt = Doubt {
            reason: "a doubt".to_owned(),
            first: false,
        };
        let may_have = |_: &str| true;
        let has_too_many = |_: &str| false;
        assert!(matches!(fate(&given, New), Fate::Stored(..)));
        for doubt in [None, Some(&doubt)] {
            let found = Fate::of(&given, Known, doubt, has_too_many);
            assert_eq!(found, Fate::Again);
        }
        for identity in [New, Refused] {
            let found = Fate::of(&given, identity, Some(&doubt), may_have);
            let Fate::TooOld { reason, noted } = found else {
                panic!("{found:?}");
            };
            assert_eq!(reason, "a doubt");
            assert!(noted.is_some(), "its identity is to be forgotten");
        }
        let Fate::Invalid { reason } = Fate::of(&given, New, None, has_too_many) else {
            panic!("it has one camera too many");
        };
        assert!(
            reason.starts_with("the node has had cameras under 4096 names"),
            "{reason}"
        );
        let old = Fate::TooOld {
            reason: "a reason",
            noted: None,
        };
        assert_eq!(fate(&too_old(), New), old);
        let wrong = Fate::Invalid {
            reason: "a reason".to_owned(),
        };
        assert_eq!(fate(&invalid(), New), wrong);
    }

    #[test]
    fn each_report_is_counted_once_and_only_what_is_not_stored_is_refused() {
        let mut result = BatchResult::default();
        let mut node = node();
        for (report, identity) in [
            (stored(1), Identity::New),
            (stored(1), Identity::Known),
            (too_old(), Identity::New),
            (invalid(), Identity::New),
        ] {
            let fate = fate(&report, identity);
            result.add(&report, &fate, &mut node);
        }
        result.end(&mut node, 7);
        let expected = IngestCounts {
            clips: 1,
            again: 1,
            too_old: 1,
            set_aside: 1,
            frames: 9,
            frames_skipped: 2,
            energy_uj: 10_000_000,
            ..IngestCounts::default()
        };
        assert_eq!(result.counts, expected);
        let expected = ReportCounts {
            stored: 1,
            refused: 1,
            set_aside: 1,
            last_ms: 7,
            ..ReportCounts::default()
        };
        assert_eq!(node.totals, expected);
        assert_eq!(result.answer.refused.len(), 2);
        let refused = BatchEvent {
            kind: "refused",
            detail: json!({"reports": 1, "reason": "a reason"}),
        };
        let set_aside = BatchEvent {
            kind: "set_aside",
            detail: json!({"reports": 1}),
        };
        assert_eq!(result.events, [refused, set_aside]);
    }

    #[test]
    fn a_gap_counts_as_a_million_reports_at_most() {
        let mut result = BatchResult::default();
        let mut node = node();
        for count in [1, 5, 1 << 53] {
            let report = stored(count);
            let fate = fate(&report, Identity::New);
            result.add(&report, &fate, &mut node);
        }
        result.end(&mut node, 7);
        assert_eq!(result.counts.missing, 3 + LARGEST_GAP);
        assert_eq!(node.totals.missing, MOST_MISSING);
        let kinds: Vec<_> = result.events.iter().map(|event| event.kind).collect();
        assert_eq!(kinds, ["gap", "gap"]);
        assert_eq!(result.answer.missing.len(), 2);
    }
}
