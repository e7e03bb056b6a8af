//! Reads the history: clips, sums of energy, events, and what was set aside.

mod energy;
mod rows;

pub use energy::{EnergyBy, EnergyGroup, EnergyQuery, Resolution, Sort};
pub use rows::{ClipQuery, StoredClip, StoredEvent, StoredSetAside};

use crate::store::row::Row;
use albireo_wire::{AuditFigures, AuditReport, AuditSquares, AuditSums};
use serde_json::Value;

/// The counts of a row with the audit's columns; null counts as 0.
fn audit(row: &Row) -> AuditReport {
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
    AuditReport {
        calls: number("audit_calls"),
        detector_us: number("audit_us"),
        sums,
        ..AuditReport::default()
    }
}

/// The audit's figures; `None` if no frame was drawn.
pub(crate) fn audit_figures(audit: &AuditReport) -> Option<AuditFigures> {
    (!audit.sums.is_empty()).then(|| audit.figures())
}
