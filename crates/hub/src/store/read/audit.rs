//! The audit of a row of sums or of a clip.

use crate::store::StoreError;
use albireo_wire::{AuditFigures, AuditSums};
use sqlx::Row as _;
use sqlx::any::AnyRow;

/// The columns that an audit is summed in.
pub(super) const COLUMNS: [&str; 19] = [
    "audit_frames",
    "audit_missed",
    "audit_calls",
    "audit_us",
    "audit_uj",
    "audit_detected",
    "audit_recalled",
    "audit_appeared",
    "audit_shown",
    "audit_confirmed",
    "audit_gone",
    "audit_overlap",
    "audit_same_class",
    "audit_detected_sq",
    "audit_recalled_sq",
    "audit_detected_x",
    "audit_shown_sq",
    "audit_confirmed_sq",
    "audit_shown_x",
];

/// What an audit counted, groups aside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AuditCounts {
    /// What was compared.
    pub sums: AuditSums,
    /// Times the detector looked.
    pub calls: u64,
    /// Its time for that, microseconds.
    pub detector_us: u64,
}

impl AuditCounts {
    /// That of a row with those columns; nulls count as nothing.
    pub(super) fn of(row: &AnyRow) -> Result<Self, StoreError> {
        let number = |name: &str| -> Result<u64, StoreError> {
            let number: Option<i64> = row.try_get(name)?;
            Ok(u64::try_from(number.unwrap_or(0)).unwrap_or(0))
        };
        let mut sums = AuditSums {
            missed: number("audit_missed")?,
            ..AuditSums::default()
        };
        // Which state it was is not kept apart: together they are the total.
        let total = &mut sums.by_state.p;
        total.frames = number("audit_frames")?;
        total.detected.boxes = number("audit_detected")?;
        total.detected.paired = number("audit_recalled")?;
        total.detected.alone = number("audit_appeared")?;
        total.shown.boxes = number("audit_shown")?;
        total.shown.paired = number("audit_confirmed")?;
        total.shown.alone = number("audit_gone")?;
        total.overlap_millionths = number("audit_overlap")?;
        total.same_class = number("audit_same_class")?;
        let spread = &mut sums.spread;
        spread.detected.boxes = number("audit_detected_sq")?;
        spread.detected.paired = number("audit_recalled_sq")?;
        spread.detected.product = number("audit_detected_x")?;
        spread.shown.boxes = number("audit_shown_sq")?;
        spread.shown.paired = number("audit_confirmed_sq")?;
        spread.shown.product = number("audit_shown_x")?;
        Ok(Self {
            sums,
            calls: number("audit_calls")?,
            detector_us: number("audit_us")?,
        })
    }

    /// Adds the other's counts.
    pub fn merge(&mut self, more: &Self) {
        self.sums.merge(&more.sums);
        self.calls = self.calls.saturating_add(more.calls);
        self.detector_us = self.detector_us.saturating_add(more.detector_us);
    }

    /// In figures; `None` where nothing was drawn.
    pub fn figures(&self) -> Option<AuditFigures> {
        (!self.sums.is_empty()).then(|| AuditFigures::new(&self.sums, self.calls, self.detector_us))
    }
}
