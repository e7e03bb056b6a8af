//! Queries the database on the connections for reading.

mod audit;
mod energy;
mod history;

pub(crate) use audit::audit_figures;
pub use energy::{EnergyBy, EnergyGroup, EnergyQuery, Resolution, Sort};
pub use history::{ClipQuery, ReportCounts, StoredClip, StoredEvent, StoredSetAside};

use super::row::read_all;
use super::tables::NodeRow;
use super::{Store, StoreError};
use crate::presence::TodaysEnergy;
use serde::Deserialize;
use std::collections::HashMap;

impl Store {
    /// The last known state of every node.
    pub(crate) async fn nodes(&self) -> Result<Vec<NodeRow>, StoreError> {
        let text = "SELECT * FROM nodes WHERE state <> 'forgotten'";
        read_all(self.query(text, Vec::new()).await?)
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
