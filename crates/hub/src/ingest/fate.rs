//! Decides what becomes of a received report, and what the node is told and counted for it. All of it is pure.

use super::clip::Clip;
use super::counters::IngestCounts;
use super::decode::{Received, Rejected};
use super::plan::{Doubt, Seen};
use super::tables::{MOST_CAMERAS, ReportCountsRow, ReportKey};
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
    /// It is set aside for this reason, with the beginning of its text.
    Invalid { reason: String, text: &'a str },
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
            Err(Rejected { reason, text: None }) => {
                return Self::TooOld {
                    reason,
                    noted: None,
                };
            }
            Err(Rejected {
                reason,
                text: Some(text),
            }) => {
                return Self::Invalid {
                    reason: reason.clone(),
                    text,
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
                reason: format!("the node has {MOST_CAMERAS} cameras already"),
                text: "",
            };
        }
        Self::Stored(key, clip)
    }

    /// The reason that the node is told, if the report is not stored.
    fn refusal(&self) -> Option<&str> {
        match self {
            Self::Stored(..) | Self::Again => None,
            Self::TooOld { reason, .. } => Some(reason),
            Self::Invalid { reason, .. } => Some(reason),
        }
    }
}

/// What the reports of one batch add up to.
#[derive(Debug, Default)]
pub(super) struct BatchResult {
    pub(super) answer: ReportAnswer,
    pub(super) counts: IngestCounts,
    /// The kinds and details of the events.
    pub(super) events: Vec<(&'static str, Value)>,
    /// The reason of the first report that is too old.
    too_old: Option<String>,
}

impl BatchResult {
    /// Counts a report, refuses it where it is not stored, and else follows the running count of its node.
    pub(super) fn add(&mut self, report: &Received, fate: &Fate<'_>, node: &mut ReportCountsRow) {
        match fate {
            Fate::Stored(_, clip) => {
                self.counts += clip.row.counted();
                self.counts.clock_off += u64::from(!clip.clock);
                node.totals.stored += 1;
            }
            Fate::Again => self.counts.again += 1,
            Fate::TooOld { reason, .. } => {
                self.counts.too_old += 1;
                node.totals.refused += 1;
                self.too_old.get_or_insert_with(|| (*reason).to_owned());
            }
            Fate::Invalid { .. } => {
                self.counts.set_aside += 1;
                node.totals.set_aside += 1;
            }
        }
        if let Some(reason) = fate.refusal() {
            let reason = reason.to_owned();
            self.answer.refused.extend(report.id.map(|id| RefusedReport { id, reason }));
            // Its running count is not followed: a report that is not stored counts as missing.
            return;
        }
        if let Some(count) = report.count {
            let seen = node.counts.see(count, matches!(fate, Fate::Stored(..)));
            self.follow(seen, count, node);
        }
    }

    fn follow(&mut self, seen: Seen, count: u64, node: &mut ReportCountsRow) {
        match seen {
            Seen::Expected => {}
            Seen::Gap(first, last) => {
                let missing = (last - first + 1).min(LARGEST_GAP);
                self.counts.missing += missing;
                let detail = json!({ "first": first, "last": last, "missing": missing });
                self.events.push(("gap", detail));
            }
            Seen::Reset => {
                self.counts.resets += 1;
                node.totals.resets += 1;
                self.events.push(("reset", json!({ "count": count })));
            }
        }
    }

    /// Ends the batch, received at `now_ms`: what concerns all of its reports.
    pub(super) fn end(&mut self, node: &mut ReportCountsRow, now_ms: i64) {
        if let Some(reason) = self.too_old.take() {
            let detail = json!({ "reports": self.counts.too_old, "reason": reason });
            self.events.push(("refused", detail));
        }
        for (kind, what, count) in [
            ("set_aside", "reports", self.counts.set_aside),
            ("clock_off", "clips", self.counts.clock_off),
        ] {
            if count > 0 {
                self.events.push((kind, json!({ what: count })));
            }
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

    fn rejected(text: Option<&str>) -> Received {
        let reason = "a reason".to_owned();
        let text = text.map(str::to_owned);
        received(Err(Rejected { reason, text }), 1)
    }

    fn node() -> ReportCountsRow {
        ReportCountsRow {
            name: "car-1".to_owned(),
            node_id: 1,
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
        let fate =
            |identity, doubt, has_place: bool| Fate::of(&given, identity, doubt, |_| has_place);
        assert!(matches!(fate(New, None, true), Fate::Stored(..)));
        for doubt in [None, Some(&doubt)] {
            assert_eq!(fate(Known, doubt, false), Fate::Again);
        }
        for identity in [New, Refused] {
            let found = fate(identity, Some(&doubt), true);
            let refused = matches!(
                found,
                Fate::TooOld {
                    reason: "a doubt",
                    noted: Some(_)
                }
            );
            assert!(refused, "{found:?}");
        }
        let Fate::Invalid { reason, text } = fate(New, None, false) else {
            panic!("no place")
        };
        assert_eq!(
            (reason.as_str(), text),
            ("the node has 64 cameras already", "")
        );
        let old = rejected(None);
        let found = Fate::of(&old, New, None, |_| true);
        let refused = matches!(
            found,
            Fate::TooOld {
                reason: "a reason",
                noted: None
            }
        );
        assert!(refused, "{found:?}");
        let wrong = rejected(Some("{}"));
        let found = Fate::of(&wrong, New, None, |_| true);
        assert!(
            matches!(found, Fate::Invalid { text: "{}", .. }),
            "{found:?}"
        );
    }

    #[test]
    fn each_report_is_counted_once_and_only_what_is_not_stored_is_refused() {
        let given = [stored(1), stored(1), rejected(None), rejected(Some("{}"))];
        let mut result = BatchResult::default();
        let mut node = node();
        let identities = [Identity::New, Identity::Known, Identity::New, Identity::New];
        for (report, identity) in given.iter().zip(identities) {
            let fate = Fate::of(report, identity, None, |_| true);
            result.add(report, &fate, &mut node);
        }
        result.end(&mut node, 7);
        let counts = result.counts;
        let found = (counts.clips, counts.again, counts.too_old, counts.set_aside);
        assert_eq!(found, (1, 1, 1, 1));
        assert_eq!(
            (counts.frames, counts.frames_skipped, counts.energy_uj),
            (9, 2, 10_000_000)
        );
        let totals = &node.totals;
        assert_eq!((totals.stored, totals.refused, totals.set_aside), (1, 1, 1));
        assert_eq!(totals.last_ms, 7);
        assert_eq!(result.answer.refused.len(), 2);
        let refused = json!({"reports": 1, "reason": "a reason"});
        let aside = json!({"reports": 1});
        assert_eq!(result.events, [("refused", refused), ("set_aside", aside)]);
    }

    #[test]
    fn a_gap_counts_as_a_million_reports_at_most() {
        let mut result = BatchResult::default();
        let mut node = node();
        for count in [1, 5, 1 << 53] {
            let report = stored(count);
            let fate = Fate::of(&report, Identity::New, None, |_| true);
            result.add(&report, &fate, &mut node);
        }
        result.end(&mut node, 7);
        assert_eq!(result.counts.missing, 3 + LARGEST_GAP);
        assert_eq!(node.totals.missing, MOST_MISSING);
        let kinds: Vec<_> = result.events.iter().map(|(kind, _)| *kind).collect();
        assert_eq!(kinds, ["gap", "gap"]);
        assert_eq!(result.answer.missing.len(), 2);
    }
}
