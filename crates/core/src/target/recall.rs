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

/// The comparisons between two moves of the threshold.
#[derive(Clone, Debug)]
struct Lot {
    /// Logarithm of the threshold.
    logarithm: f64,
    sums: AuditSums,
}

#[derive(Clone, Debug)]
pub(super) struct RecallControl {
    wanted: f64,
    /// Comparisons since the threshold last moved.
    current: AuditSums,
    previous: VecDeque<Lot>,
    verdict: Verdict,
    without_audit_s: f64,
}

impl RecallControl {
    pub(super) fn new(wanted: f64) -> Self {
        Self {
            wanted,
            current: AuditSums::default(),
            previous: VecDeque::new(),
            verdict: Verdict {
                actual: None,
                status: TargetStatus::Measuring,
                boxes: None,
            },
            without_audit_s: 0.0,
        }
    }

    pub(super) fn step(&mut self, measured: &Measured, lever: &mut Lever) -> Verdict {
        self.current.merge(&measured.audit);
        if measured.audit.is_empty() {
            if measured.skipped > 0 {
                self.without_audit_s += measured.seconds.max(0.0);
            }
        } else {
            self.without_audit_s = 0.0;
        }
        let recall = self.current.compared_recall();
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
        let sums = std::mem::take(&mut self.current);
        if sums.missed_share() > MOST_MISSED {
            self.verdict.status = TargetStatus::Measuring;
            return;
        }
        let logarithm = lever.logarithm();
        self.previous.push_back(Lot { logarithm, sums });
        while self.previous.len() > MOST_LOTS {
            self.previous.pop_front();
        }
        self.previous.retain(|lot| (lot.logarithm - logarithm).abs() <= NEAR);
        let mut pooled = AuditSums::default();
        for lot in &self.previous {
            pooled.merge(&lot.sums);
        }
        let Some(recall) = pooled.compared_recall() else {
            return;
        };
        let off = recall.low - self.wanted;
        // Half the gain upward, where accuracy is given away.
        let gain = if off > 0.0 { GAIN / 2.0 } else { GAIN };
        if off.abs() > HELD {
            lever.push((gain * off).clamp(-LARGEST, LARGEST));
        }
        let status = if off.abs() <= HELD {
            TargetStatus::Held
        } else if off < 0.0 && lever.is_at_least() {
            TargetStatus::CannotBeMet
        } else if off > 0.0 && lever.is_at_most() {
            TargetStatus::MoreThanKept
        } else {
            TargetStatus::Moving
        };
        self.verdict = Verdict {
            actual: Some(recall.low),
            boxes: Some(recall.boxes),
            status,
        };
    }
}
