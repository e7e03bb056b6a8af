//! Queries the database on the connections for reading.

mod energy;
mod history;

pub use energy::{EnergyBy, EnergyGroup, EnergyQuery, Resolution, Sort};
pub use history::{ClipQuery, ReportCounts, StoredClip, StoredEvent, StoredSetAside};

use super::row::{Row, read, read_all};
use super::{Store, StoreError};
use crate::presence::{NodeView, TodaysEnergy};
use albireo_wire::{AuditFigures, AuditReport, AuditSquares, AuditSums};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::HashMap;

impl Store {
    /// The last known state of every node.
    pub(crate) async fn nodes(&self) -> Result<Vec<NodeView>, StoreError> {
        let text = "SELECT name AS node, state, since_ms, why, heard_ms, revision, status, 0 AS waiting \
                    FROM nodes WHERE state <> 'forgotten'";
        let node = |mut row: Row| {
            row.insert("today".to_owned(), json!(TodaysEnergy::default()));
            // The status may be of another version of the program; the node will send a new one.
            read(row.clone()).or_else(|_| {
                row.remove("status");
                read(row)
            })
        };
        let rows = self.query(text, Vec::new()).await?;
        rows.into_iter().map(node).collect()
    }

    /// The energy and skip rate of the clips of the day that begins at `since_s`, by node.
    pub(crate) async fn today(
        &self,
        since_s: i64,
    ) -> Result<HashMap<String, TodaysEnergy>, StoreError> {
        #[derive(Deserialize)]
        struct Used {
            node: String,
            #[serde(flatten)]
            today: TodaysEnergy,
        }
        let rows = self.query(include_str!("sql/today.sql"), vec![since_s.into()]);
        let used: Vec<Used> = read_all(rows.await?)?;
        Ok(used.into_iter().map(|one| (one.node, one.today)).collect())
    }
}

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
