//! What is counted: instances with their cursors, sums over time, presence, and whether a report is known.

use super::Writing;
use crate::store::StoreError;
use crate::store::rows::{Key, Row as _, casts, names};
use crate::store::tables::{EventRow, InstanceRow, NodeRow, SUM_KEYS, SumRow, summed};
use sqlx::Row as _;
use std::collections::HashMap;

/// What is kept of an instance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Instance {
    /// Its number.
    pub(crate) id: i64,
    /// Digest of the machine it was first heard from.
    pub(crate) machine: Option<String>,
    /// The cursor: number of the first report that is not stored.
    pub(crate) next_report: i64,
    /// When it was first heard, milliseconds since the Unix epoch.
    pub(crate) first_ms: i64,
    /// When it was heard last.
    pub(crate) last_ms: i64,
    /// Latest beginning of a clip of it, nanoseconds since the Unix epoch.
    pub(crate) latest_started_ns: i64,
    /// Reports stored.
    pub(crate) reports: i64,
    /// Reports set aside.
    pub(crate) set_aside: i64,
    /// Reports that never came.
    pub(crate) missing: i64,
    /// Of these, those that the node says it lost.
    pub(crate) lost: i64,
    /// Reports whose number was taken by another.
    pub(crate) conflicts: i64,
}

/// What is known of a report below its instance's cursor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Known {
    /// A clip that began at that time, nanoseconds since the Unix epoch.
    Clip(i64),
    /// It was set aside.
    SetAside,
}

impl Writing<'_> {
    /// The instances, given by node and identity, made where they are new; no other hub changes them until the
    /// commit.
    pub(crate) async fn instances(
        &mut self,
        wanted: &[(i64, String)],
        now_ms: i64,
    ) -> Result<HashMap<(i64, String), Instance>, StoreError> {
        let rows: Vec<Key<3>> = wanted
            .iter()
            .map(|(node, instance)| Key([(*node).into(), instance.as_str().into(), now_ms.into()]))
            .collect();
        self.with(
            "INSERT INTO instances (node_id, instance, next_report, first_ms, last_ms, latest_started_ns, reports, \
             set_aside, missing, lost, conflicts) \
             SELECT CAST(r.value ->> 0 AS BIGINT), CAST(r.value ->> 1 AS TEXT), 1, CAST(r.value ->> 2 AS BIGINT), \
             CAST(r.value ->> 2 AS BIGINT), 0, 0, 0, 0, 0, 0 FROM {ROWS} WHERE true ON CONFLICT DO NOTHING",
            &rows,
        )
        .await?;
        let found = self
            .ask(
                "SELECT i.* FROM {ROWS} CROSS JOIN instances i \
                 WHERE i.node_id = CAST(r.value ->> 0 AS BIGINT) AND i.instance = r.value ->> 1 \
                 ORDER BY i.id {FOR_UPDATE}",
                &rows,
            )
            .await?;
        found
            .iter()
            .map(|row| {
                let instance = Instance {
                    id: row.try_get("id")?,
                    machine: row.try_get("machine")?,
                    next_report: row.try_get("next_report")?,
                    first_ms: row.try_get("first_ms")?,
                    last_ms: row.try_get("last_ms")?,
                    latest_started_ns: row.try_get("latest_started_ns")?,
                    reports: row.try_get("reports")?,
                    set_aside: row.try_get("set_aside")?,
                    missing: row.try_get("missing")?,
                    lost: row.try_get("lost")?,
                    conflicts: row.try_get("conflicts")?,
                };
                let key = (row.try_get("node_id")?, row.try_get("instance")?);
                Ok((key, instance))
            })
            .collect()
    }

    /// What is known of reports, given by instance and number.
    pub(crate) async fn known(
        &mut self,
        reports: &[(i64, i64)],
    ) -> Result<HashMap<(i64, i64), Known>, StoreError> {
        let rows: Vec<Key<2>> = reports
            .iter()
            .map(|(instance, report)| Key([(*instance).into(), (*report).into()]))
            .collect();
        let wanted = "instance_id = CAST(r.value ->> 0 AS BIGINT) AND t.report = CAST(r.value ->> 1 AS BIGINT)";
        let mut known = HashMap::new();
        let text = format!(
            "SELECT t.instance_id, t.report FROM {{ROWS}} CROSS JOIN set_aside t WHERE t.{wanted}"
        );
        for row in self.ask(&text, &rows).await? {
            known.insert(
                (row.try_get("instance_id")?, row.try_get("report")?),
                Known::SetAside,
            );
        }
        let text = format!(
            "SELECT t.instance_id, t.report, t.started_ns FROM {{ROWS}} CROSS JOIN clips t WHERE t.{wanted}"
        );
        for row in self.ask(&text, &rows).await? {
            known.insert(
                (row.try_get("instance_id")?, row.try_get("report")?),
                Known::Clip(row.try_get("started_ns")?),
            );
        }
        Ok(known)
    }

    /// Writes what is known of instances.
    pub(crate) async fn update_instances(
        &mut self,
        rows: &[InstanceRow],
    ) -> Result<(), StoreError> {
        let columns = &InstanceRow::COLUMNS[1..];
        let sets: Vec<String> = columns
            .iter()
            .zip(1..)
            .map(|((name, kind), index)| format!("{name} = CAST(r.value ->> {index} AS {kind})"))
            .collect();
        let text = format!(
            "UPDATE instances SET {} FROM {{ROWS}} WHERE instances.id = CAST(r.value ->> 0 AS BIGINT)",
            sets.join(", ")
        );
        self.with(&text, rows).await.map(drop)
    }

    /// Adds sums to those of `table`, `sums_5m` or `sums_day`. The rows come in the order of their keys, so that two
    /// hubs do not wait for each other.
    pub(crate) async fn add_sums(
        &mut self,
        table: &str,
        rows: &[SumRow],
    ) -> Result<(), StoreError> {
        let adds: Vec<String> = summed()
            .map(|name| format!("{name} = {table}.{name} + excluded.{name}"))
            .collect();
        let text = format!(
            "INSERT INTO {table} ({}) SELECT {} FROM {{ROWS}} WHERE true ON CONFLICT ({}) DO UPDATE SET {}",
            names(SumRow::COLUMNS),
            casts(SumRow::COLUMNS),
            names(&SumRow::COLUMNS[..SUM_KEYS]),
            adds.join(", ")
        );
        self.with(&text, rows).await.map(drop)
    }

    /// Writes what is known of nodes. Those whose state changed are returned with the state before: of several hubs
    /// that see the same, one changes it.
    pub(crate) async fn update_nodes(
        &mut self,
        rows: &[NodeRow],
    ) -> Result<Vec<(i64, String)>, StoreError> {
        let found = self
            .ask(
                "SELECT n.id, n.state AS before FROM {ROWS} CROSS JOIN nodes n \
                 WHERE n.id = CAST(r.value ->> 0 AS BIGINT) AND n.state <> r.value ->> 1 ORDER BY n.id",
                rows,
            )
            .await?;
        let changed = found
            .iter()
            .map(|row| Ok((row.try_get("id")?, row.try_get("before")?)))
            .collect::<Result<Vec<_>, StoreError>>()?;
        let sets: Vec<String> = NodeRow::COLUMNS
            .iter()
            .enumerate()
            .skip(1)
            .map(|(index, (name, kind))| {
                let value = format!("CAST(r.value ->> {index} AS {kind})");
                match *name {
                    // What is not told now stays as it was.
                    "heard_ms" | "instance" | "machine" | "started_ns" | "status" => {
                        format!("{name} = COALESCE({value}, nodes.{name})")
                    }
                    // Two hubs see the same a little apart: the first one's time holds.
                    "since_ms" => format!(
                        "since_ms = CASE WHEN nodes.state = r.value ->> 1 THEN nodes.since_ms ELSE {value} END"
                    ),
                    _ => format!("{name} = {value}"),
                }
            })
            .collect();
        let text = format!(
            "UPDATE nodes SET {} FROM {{ROWS}} WHERE nodes.id = CAST(r.value ->> 0 AS BIGINT)",
            sets.join(", ")
        );
        self.with(&text, rows).await?;
        Ok(changed)
    }

    /// Writes events and gives them their numbers, in order.
    pub(crate) async fn events(&mut self, events: &[EventRow]) -> Result<(), StoreError> {
        if events.is_empty() {
            return Ok(());
        }
        self.events_in_order().await?;
        self.insert("events", events).await.map(drop)
    }

    /// Deletes with a statement whose parameters are a bound and how many rows at most; how many it were.
    pub(crate) async fn delete(
        &mut self,
        text: &str,
        bound: i64,
        most: i64,
    ) -> Result<u64, StoreError> {
        let query = self.query(text).bind(bound).bind(most);
        Ok(query.execute(&mut *self.transaction).await?.rows_affected())
    }
}
