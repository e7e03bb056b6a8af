//! Reads, on connections of their own.

mod audit;
mod energy;
mod history;

pub use audit::AuditCounts;
pub use energy::{EnergyBy, EnergyGroup, EnergyQuery, Resolution, Sort};
pub use history::{ClipQuery, ReportCounts, StoredClip, StoredEvent, StoredSetAside};

use super::row::read_all;
use super::tables::NodeRow;
use super::{Store, StoreError};

impl Store {
    /// Every node as it was known last.
    pub(crate) async fn nodes(&self) -> Result<Vec<NodeRow>, StoreError> {
        let text = "SELECT * FROM nodes WHERE state <> 'forgotten'";
        read_all(self.query(text, Vec::new()).await?)
    }
}
