//! Reads the history: clips and their positions, sums of energy, events, and what was set aside.

mod energy;
mod positions;
mod rows;

pub use energy::{EnergyBy, EnergyGroup, EnergyQuery, Resolution, Sort};
pub use positions::{PositionQuery, PositionedClip};
pub use rows::{ClipQuery, StoredClip, StoredEvent, StoredSetAside};

use crate::store::StoreError;
use crate::store::row::{FromRow, Row};
use albireo_wire::{AuditFigures, AuditReport, EnergyQuality};

/// The audit's columns of a clip or of sums; null where no clip has an audit. The databases sum them as floating-point numbers.
struct AuditColumns(AuditReport);

impl FromRow for AuditColumns {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        // In the order of the statements' columns. Without an audit nothing was counted.
        let mut count = || Ok::<_, StoreError>(row.take::<Option<f64>>()?.unwrap_or(0.0) as u64);
        let mut audit = AuditReport::default();
        audit.sums.frames = count()?;
        audit.sums.missed = count()?;
        audit.sums.missed_boxes = count()?;
        audit.calls = count()?;
        audit.detector_us = count()?;
        audit.sums.detected = count()?;
        audit.sums.shown = count()?;
        audit.sums.paired = count()?;
        let squares = &mut audit.sums.squares;
        squares.detected = count()?;
        squares.detected_paired = count()?;
        squares.shown = count()?;
        squares.paired = count()?;
        squares.shown_paired = count()?;
        Ok(Self(audit))
    }
}

/// The quality of energy that the statements call by that name.
fn quality(name: &str) -> Option<EnergyQuality> {
    match name {
        "measured" => Some(EnergyQuality::Measured),
        "partial" => Some(EnergyQuality::Partial),
        "estimated" => Some(EnergyQuality::Estimated),
        "unavailable" => Some(EnergyQuality::Unavailable),
        _ => None,
    }
}

/// The audit's figures; `None` if no frame was drawn.
pub(crate) fn audit_figures(audit: &AuditReport) -> Option<AuditFigures> {
    if audit.sums.is_empty() {
        return None;
    }
    Some(audit.figures())
}
