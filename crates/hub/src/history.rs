//! Reads the history: clips and their positions, sums of energy, events, and what was set aside.

mod energy;
mod positions;
mod rows;

pub use energy::{EnergyBy, EnergyGroup, EnergyQuery, Resolution, Sort};
pub use positions::{PositionQuery, PositionedClip};
pub use rows::{ClipQuery, StoredClip, StoredEvent, StoredSetAside};

use albireo_wire::{AuditFigures, AuditReport, AuditSquares, AuditSums};
use serde::Deserialize;

/// The audit's columns of a clip or of sums; null where no clip has an audit. The databases sum them as floating-point numbers.
#[derive(Deserialize)]
struct AuditColumns {
    audit_frames: Option<f64>,
    audit_missed: Option<f64>,
    audit_missed_boxes: Option<f64>,
    audit_calls: Option<f64>,
    audit_us: Option<f64>,
    audit_detected: Option<f64>,
    audit_shown: Option<f64>,
    audit_paired: Option<f64>,
    audit_detected_sq: Option<f64>,
    audit_shown_sq: Option<f64>,
    audit_paired_sq: Option<f64>,
    audit_detected_x: Option<f64>,
    audit_shown_x: Option<f64>,
}

impl AuditColumns {
    /// The counts; without an audit all are 0.
    fn report(&self) -> AuditReport {
        let count = |sum: Option<f64>| sum.unwrap_or(0.0) as u64;
        AuditReport {
            calls: count(self.audit_calls),
            detector_us: count(self.audit_us),
            sums: AuditSums {
                missed: count(self.audit_missed),
                missed_boxes: count(self.audit_missed_boxes),
                frames: count(self.audit_frames),
                detected: count(self.audit_detected),
                shown: count(self.audit_shown),
                paired: count(self.audit_paired),
                squares: AuditSquares {
                    detected: count(self.audit_detected_sq),
                    shown: count(self.audit_shown_sq),
                    paired: count(self.audit_paired_sq),
                    detected_paired: count(self.audit_detected_x),
                    shown_paired: count(self.audit_shown_x),
                },
            },
            ..AuditReport::default()
        }
    }
}

/// The audit's figures; `None` if no frame was drawn.
pub(crate) fn audit_figures(audit: &AuditReport) -> Option<AuditFigures> {
    (!audit.sums.is_empty()).then(|| audit.figures())
}
