//! The recall target: holds the lower end of the recall's interval.
//!
//! It uses the boxes that the audit compares, and so is as fast as they arrive: the threshold moves whenever [`ENOUGH`]
//! independent boxes have been compared since its last move. If 2 % of 10 skipped frames per second are drawn, with
//! five boxes each, that is every minute or two.

use super::{Lever, Measured, TargetStatus, Verdict};
use crate::audit::AuditSums;
use std::collections::VecDeque;

/// Number of independent boxes of the detector after which the threshold moves. At a recall of 0.9 the interval then
/// reaches 0.1 below it, and 0.03 over all lots kept.
const ENOUGH: f64 = 60.0;

/// Comparisons at a threshold further than this from the current one (in its logarithm) are not used.
const NEAR: f64 = 0.4;

/// Largest share of the drawn frames that may be missed. A detector has no time in the busiest scenes, so the rest
/// would be the easier frames: the threshold does not move.
const MOST_MISSED: f64 = 0.2;

/// Maximum number of lots kept.
const MOST_LOTS: usize = 8;

/// Change of the threshold's logarithm for a recall error of one; a factor e of the threshold costs about 0.05.
const GAIN: f64 = 10.0;

/// Largest single change.
const LARGEST: f64 = 0.5;

/// The target counts as held within this distance.
const HELD: f64 = 0.01;

/// Seconds with skipped frames and none drawn after which the status is "no audit".
const NO_AUDIT_AFTER_S: f64 = 600.0;

#[derive(Clone, Debug)]
pub(super) struct RecallControl {
    wanted: f64,
    /// Comparisons since the threshold last moved.
    lot: AuditSums,
    /// The previous lots, each with the logarithm of its threshold.
    lots: VecDeque<(f64, AuditSums)>,
    verdict: Verdict,
    without_audit_s: f64,
}

impl RecallControl {
    pub(super) fn new(wanted: f64) -> Self {
        Self {
            wanted,
            lot: AuditSums::default(),
            lots: VecDeque::new(),
            verdict: Verdict {
                actual: None,
                status: TargetStatus::Measuring,
                boxes: None,
            },
            without_audit_s: 0.0,
        }
    }

    pub(super) fn step(&mut self, measured: &Measured, lever: &mut Lever) -> Verdict {
        self.lot.merge(&measured.audit);
        if measured.audit.is_empty() {
            if measured.skipped > 0 {
                self.without_audit_s += measured.seconds.max(0.0);
            }
        } else {
            self.without_audit_s = 0.0;
        }
        let recall = self.lot.compared_recall();
        let enough = recall.is_some_and(|recall| recall.independent >= ENOUGH);
        if enough {
            self.decide(lever);
        } else if self.without_audit_s > NO_AUDIT_AFTER_S {
            return Verdict {
                status: TargetStatus::NoAudit,
                ..self.verdict
            };
        }
        self.verdict
    }

    /// Moves the threshold by the lot that is complete and those before it.
    fn decide(&mut self, lever: &mut Lever) {
        let lot = std::mem::take(&mut self.lot);
        if lot.missed_share() > MOST_MISSED {
            self.verdict.status = TargetStatus::Measuring;
            return;
        }
        self.lots.push_back((lever.logarithm(), lot));
        while self.lots.len() > MOST_LOTS {
            self.lots.pop_front();
        }
        self.lots.retain(|(x, _)| (x - lever.logarithm()).abs() <= NEAR);
        let mut all = AuditSums::default();
        for (_, lot) in &self.lots {
            all.merge(lot);
        }
        let Some(recall) = all.compared_recall() else {
            return;
        };
        let off = recall.low - self.wanted;
        // Half the gain upward, where accuracy is given away.
        let gain = if off > 0.0 { GAIN / 2.0 } else { GAIN };
        if off.abs() > HELD {
            lever.push((gain * off).clamp(-LARGEST, LARGEST));
        }
        self.verdict = Verdict {
            actual: Some(recall.low),
            boxes: Some(recall.boxes),
            status: if off.abs() <= HELD {
                TargetStatus::Held
            } else if off < 0.0 && lever.is_at_least() {
                TargetStatus::CannotBeMet
            } else if off > 0.0 && lever.is_at_most() {
                TargetStatus::MoreThanKept
            } else {
                TargetStatus::Moving
            },
        };
    }
}
