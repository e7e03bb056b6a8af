//! Queries the database on the connections for reading.

mod audit;
mod energy;
mod history;

pub(crate) use audit::audit_figures;
pub use energy::{EnergyBy, EnergyGroup, EnergyQuery, Resolution, Sort};
pub use history::{ClipQuery, ReportCounts, StoredClip, StoredEvent, StoredSetAside};

use super::row::{Row, read, read_all};
use super::{Store, StoreError};
use crate::presence::{NodeView, TodaysEnergy};
use serde::Deserialize;
use serde_json::json;
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
