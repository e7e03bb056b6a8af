//! Reading, on connections of its own.

mod audit;
mod energy;
mod history;

pub use audit::AuditCounts;
pub use energy::{EnergyBy, EnergyGroup, EnergyQuery, Resolution};
pub use history::{ClipQuery, ReportCounts, StoredClip, StoredEvent, StoredSetAside};

use super::{Store, StoreError};
use crate::presence::{PresenceState, Remembered};
use sqlx::Any;
use sqlx::Row as _;
use sqlx::any::{AnyArguments, AnyRow};

impl Store {
    fn query(&self, text: &str) -> sqlx::query::Query<'static, Any, AnyArguments> {
        sqlx::query(self.dialect.sql(text))
    }

    async fn all(
        &self,
        query: sqlx::query::Query<'static, Any, AnyArguments>,
    ) -> Result<Vec<AnyRow>, StoreError> {
        Ok(query.fetch_all(&self.readers).await?)
    }

    /// Every node as it was known last.
    pub(crate) async fn remembered(&self) -> Result<Vec<Remembered>, StoreError> {
        let rows = self
            .all(self.query("SELECT * FROM nodes WHERE state <> 'forgotten'"))
            .await?;
        rows.iter()
            .map(|row| {
                let state: String = row.try_get("state")?;
                Ok(Remembered {
                    name: row.try_get("name")?,
                    state: PresenceState::named(&state).unwrap_or(PresenceState::Silent),
                    since_ms: row.try_get("since_ms")?,
                    why: row.try_get("why")?,
                    heard_ms: row.try_get("heard_ms")?,
                    run: row.try_get("run")?,
                    started_ns: row.try_get("started_ns")?,
                    revision: row.try_get("revision")?,
                    status: row.try_get("status")?,
                })
            })
            .collect()
    }
}
