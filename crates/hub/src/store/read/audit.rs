//! Reads the audit's counts from the row of a clip or of sums.

use crate::store::row::Row;
use albireo_wire::{AuditFigures, AuditSquares, AuditSums};
use serde_json::Value;

/// The counts of an audit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AuditCounts {
    /// The sums over the compared frames.
    pub sums: AuditSums,
    /// Calls of the detector.
    pub calls: u64,
    /// Time of these calls, microseconds.
    pub detector_us: u64,
}

impl AuditCounts {
    /// The counts of a row with the audit's columns; null counts as 0.
    pub(super) fn of(row: &Row) -> Self {
        let number = |name: &str| row.get(name).and_then(Value::as_f64).unwrap_or(0.0) as u64;
        let sums = AuditSums {
            missed: number("audit_missed"),
            missed_boxes: number("audit_missed_boxes"),
            frames: number("audit_frames"),
            detected: number("audit_detected"),
            shown: number("audit_shown"),
            paired: number("audit_paired"),
            squares: AuditSquares {
                detected: number("audit_detected_sq"),
                shown: number("audit_shown_sq"),
                paired: number("audit_paired_sq"),
                detected_paired: number("audit_detected_x"),
                shown_paired: number("audit_shown_x"),
            },
        };
        Self {
            sums,
            calls: number("audit_calls"),
            detector_us: number("audit_us"),
        }
    }

    /// Adds the other's counts.
    pub(crate) fn merge(&mut self, more: &Self) {
        self.sums.merge(&more.sums);
        self.calls = self.calls.saturating_add(more.calls);
        self.detector_us = self.detector_us.saturating_add(more.detector_us);
    }

    /// The audit's figures; `None` if no frame was drawn.
    pub fn figures(&self) -> Option<AuditFigures> {
        (!self.sums.is_empty()).then(|| AuditFigures::new(&self.sums, self.calls, self.detector_us))
    }
}
