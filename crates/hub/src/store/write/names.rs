//! Names and their numbers: nodes, cameras, setups. Rows of clips have the numbers only.

use super::Writing;
use crate::store::StoreError;
use crate::store::rows::{Key, text};
use sqlx::Row as _;
use std::collections::HashMap;

/// With what a clip was made. Clips with the same have one number in the place of seven texts.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct SetupKey {
    /// Policy.
    pub(crate) policy: String,
    /// Name of the knob; empty without one.
    pub(crate) knob: String,
    /// Its value as it is written shortest; empty without one.
    pub(crate) value: String,
    /// Detector model.
    pub(crate) model: String,
    /// Execution provider.
    pub(crate) provider: String,
    /// Where the energy comes from.
    pub(crate) power_source: String,
    /// How its total came about.
    pub(crate) total_from: String,
}

impl SetupKey {
    fn key(&self) -> Key<7> {
        Key([
            &self.policy,
            &self.knob,
            &self.value,
            &self.model,
            &self.provider,
            &self.power_source,
            &self.total_from,
        ]
        .map(|part| text(part).as_str().into()))
    }
}

impl Writing<'_> {
    /// The numbers of nodes, made where they are new at `now_ms`.
    pub(crate) async fn nodes(
        &mut self,
        names: &[String],
        now_ms: i64,
    ) -> Result<HashMap<String, i64>, StoreError> {
        let rows: Vec<Key<2>> = names
            .iter()
            .map(|name| Key([name.as_str().into(), now_ms.into()]))
            .collect();
        self.with(
            "INSERT INTO nodes (name, first_seen_ms, state, since_ms, why) \
             SELECT CAST(r.value ->> 0 AS TEXT), CAST(r.value ->> 1 AS BIGINT), 'silent', \
             CAST(r.value ->> 1 AS BIGINT), 'no status has come yet' FROM {ROWS} WHERE true ON CONFLICT DO NOTHING",
            &rows,
        )
        .await?;
        let found = self
            .ask(
                "SELECT n.id, n.name FROM {ROWS} CROSS JOIN nodes n WHERE n.name = r.value ->> 0",
                &rows,
            )
            .await?;
        found
            .iter()
            .map(|row| Ok((row.try_get("name")?, row.try_get("id")?)))
            .collect()
    }

    /// The numbers of cameras, given by node and name.
    pub(crate) async fn cameras(
        &mut self,
        cameras: &[(i64, String)],
    ) -> Result<HashMap<(i64, String), i64>, StoreError> {
        let rows: Vec<Key<2>> = cameras
            .iter()
            .map(|(node, name)| Key([(*node).into(), name.as_str().into()]))
            .collect();
        self.with(
            "INSERT INTO cameras (node_id, name) SELECT CAST(r.value ->> 0 AS BIGINT), CAST(r.value ->> 1 AS TEXT) \
             FROM {ROWS} WHERE true ON CONFLICT DO NOTHING",
            &rows,
        )
        .await?;
        let found = self
            .ask(
                "SELECT c.id, c.node_id, c.name FROM {ROWS} CROSS JOIN cameras c \
                 WHERE c.node_id = CAST(r.value ->> 0 AS BIGINT) AND c.name = r.value ->> 1",
                &rows,
            )
            .await?;
        found
            .iter()
            .map(|row| {
                Ok((
                    (row.try_get("node_id")?, row.try_get("name")?),
                    row.try_get("id")?,
                ))
            })
            .collect()
    }

    /// The numbers of setups.
    pub(crate) async fn setups(
        &mut self,
        setups: &[SetupKey],
    ) -> Result<HashMap<SetupKey, i64>, StoreError> {
        let rows: Vec<Key<7>> = setups.iter().map(SetupKey::key).collect();
        self.with(
            "INSERT INTO setups (policy, knob, value, model, provider, power_source, total_from) \
             SELECT r.value ->> 0, r.value ->> 1, r.value ->> 2, r.value ->> 3, r.value ->> 4, r.value ->> 5, \
             r.value ->> 6 FROM {ROWS} WHERE true ON CONFLICT DO NOTHING",
            &rows,
        )
        .await?;
        let found = self
            .ask(
                "SELECT s.* FROM {ROWS} CROSS JOIN setups s \
                 WHERE s.policy = r.value ->> 0 AND s.knob = r.value ->> 1 AND s.value = r.value ->> 2 \
                 AND s.model = r.value ->> 3 AND s.provider = r.value ->> 4 AND s.power_source = r.value ->> 5 \
                 AND s.total_from = r.value ->> 6",
                &rows,
            )
            .await?;
        found
            .iter()
            .map(|row| {
                let setup = SetupKey {
                    policy: row.try_get("policy")?,
                    knob: row.try_get("knob")?,
                    value: row.try_get("value")?,
                    model: row.try_get("model")?,
                    provider: row.try_get("provider")?,
                    power_source: row.try_get("power_source")?,
                    total_from: row.try_get("total_from")?,
                };
                Ok((setup, row.try_get("id")?))
            })
            .collect()
    }
}
