//! Orders, desired values and what became of them; rollouts and trials.

use super::record::{Cell, FromCell, Row, record};
use super::{Kind, Store, StoreError, Transaction};
use crate::tuning::member::{Counts, Outcome};
use crate::tuning::metric::{Figure, Figures, Mean};
use crate::tuning::run::Window;
use crate::tuning::runs::KeptRun;
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use utoipa::ToSchema;

record! {
    /// A change: a setting that was ordered for some nodes.
    #[derive(Serialize, Deserialize, ToSchema)]
    pub struct ChangeRow {
        /// Its number, which nodes report as the revision of their setting.
        revision: i64,
        /// When, milliseconds since the Unix epoch.
        at_ms: i64,
        /// Who: the name of the token.
        who: String,
        /// Why.
        why: String,
        /// `hand`, `rollout 3`, `trial 4`, `drift`.
        origin: String,
        /// Who was selected; empty where a rollout or trial chose.
        #[serde(rename = "select")]
        selector: String,
        /// What was ordered: a threshold, or a target (null switches it off).
        #[serde(rename = "to")]
        setting: DesiredSetting,
    }
}

record! {
    /// What became of a change at one node.
    #[derive(Serialize, Deserialize, ToSchema)]
    pub struct ChangeNode {
        /// The number of the change.
        revision: i64,
        /// The node.
        node: String,
        /// Its setting before, if that was known: a threshold or a target.
        #[serde(rename = "from")]
        setting_before: Option<DesiredSetting>,
        /// What became of it.
        outcome: Outcome,
        /// When that was known, milliseconds since the Unix epoch.
        at_ms: i64,
        /// Why, where there is something to say.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        detail: String,
    }
}

impl From<Outcome> for Cell {
    fn from(outcome: Outcome) -> Self {
        outcome.name().into()
    }
}

impl FromCell for Outcome {
    fn read(cell: &Cell) -> Option<Self> {
        Self::named(&String::read(cell)?)
    }
}

record! {
    /// What is desired of a node.
    pub(crate) struct DesiredRow {
        node: String,
        revision: i64,
        setting: DesiredSetting,
    }
}

const OPEN: &str = "outcome IN ('pending', 'waiting', 'timed_out')";

impl dyn Transaction + '_ {
    /// The next revision: greater than any before, whatever hub gave it, and than `above`.
    pub(crate) fn next_revision(&mut self, above: i64) -> Result<i64, StoreError> {
        self.next(
            "UPDATE counters SET value = CASE WHEN value < $1 THEN $1 ELSE value END + 1 \
             WHERE name = 'revision' RETURNING value",
            above,
        )
    }

    fn next(&mut self, counter: &str, with: impl Into<Cell>) -> Result<i64, StoreError> {
        let rows = self.query(counter, &[with.into()])?;
        let row = rows.first();
        row.ok_or_else(|| StoreError::Statement("there is no such counter".to_owned()))?
            .get("value")
    }

    /// Stores an order and its nodes, and makes what it orders the desired setting where none of a higher revision is.
    pub(crate) fn order(
        &mut self,
        order: &ChangeRow,
        nodes: &[ChangeNode],
    ) -> Result<(), StoreError> {
        let desired = nodes.iter().map(|node| DesiredRow {
            node: node.node.clone(),
            revision: order.revision,
            setting: order.setting,
        });
        self.upsert_rows(
            "desired",
            &desired.collect::<Vec<_>>(),
            "ON CONFLICT (node) DO UPDATE SET revision = excluded.revision, \
             setting = excluded.setting WHERE excluded.revision > desired.revision",
        )?;
        self.insert_rows("orders", std::slice::from_ref(order))?;
        self.outcomes(nodes)?;
        let superseded = format!(
            "UPDATE order_nodes SET outcome = 'superseded', at_ms = $1 WHERE {OPEN} AND revision < $2 \
             AND node IN (SELECT node FROM order_nodes WHERE revision = $2)"
        );
        self.execute(&superseded, &[order.at_ms.into(), order.revision.into()])?;
        Ok(())
    }

    /// Takes a node off the list and drops what is desired of it; its clips and its history stay.
    pub(crate) fn forget(&mut self, node: &str, now_ms: i64) -> Result<(), StoreError> {
        let open = format!(
            "UPDATE order_nodes SET outcome = 'missed', at_ms = $2, detail = 'the node was forgotten' \
             WHERE node = $1 AND {OPEN}"
        );
        self.execute(&open, &[node.into(), now_ms.into()])?;
        self.execute("DELETE FROM desired WHERE node = $1", &[node.into()])?;
        self.execute(
            "UPDATE nodes SET state = 'forgotten', since_ms = $2, status = NULL, heard_ms = NULL WHERE name = $1",
            &[node.into(), now_ms.into()],
        )?;
        Ok(())
    }

    /// Stores what became of orders; an order that has ended meanwhile, as of a node that was forgotten, keeps its outcome.
    pub(crate) fn outcomes(&mut self, nodes: &[ChangeNode]) -> Result<(), StoreError> {
        let update = format!(
            "ON CONFLICT (revision, node) DO UPDATE SET outcome = excluded.outcome, at_ms = excluded.at_ms, \
             detail = excluded.detail WHERE order_nodes.{OPEN}"
        );
        self.upsert_rows("order_nodes", nodes, &update)
    }

    /// Begins a rollout or trial, driven by `driver`. Returns its number.
    pub(crate) fn begin_run(
        &mut self,
        kept: &KeptRun,
        driver: &str,
        until_ms: i64,
    ) -> Result<i64, StoreError> {
        let kind = kept.run.kind.name();
        let id = self.next(
            "UPDATE counters SET value = value + 1 WHERE name = $1 RETURNING value",
            kind,
        )?;
        self.execute(
            "INSERT INTO runs (kind, id, begun_ms, who, driver, driven_until_ms, state) \
             VALUES ($1, $2, $3, $4, $5, $6, $7)",
            &[
                kind.into(),
                id.into(),
                kept.begun_ms.into(),
                kept.who.as_str().into(),
                driver.into(),
                until_ms.into(),
                serde_json::to_string(&kept.run)?.into(),
            ],
        )?;
        Ok(id)
    }

    /// Stores a rollout or trial if `driver` still drives it; with `until_ms` it does from now on, also one that had ended.
    pub(crate) fn save_run(
        &mut self,
        kept: &KeptRun,
        driver: &str,
        until_ms: Option<i64>,
    ) -> Result<(), StoreError> {
        self.execute(
            "UPDATE runs SET ended_ms = $3, state = $4, driver = $5, \
             driven_until_ms = CASE WHEN $6 > 0 THEN $6 ELSE driven_until_ms END \
             WHERE kind = $1 AND id = $2 AND (driver = $5 OR $6 > 0)",
            &[
                kept.run.kind.name().into(),
                kept.id.into(),
                kept.ended_ms.into(),
                serde_json::to_string(&kept.run)?.into(),
                driver.into(),
                until_ms.unwrap_or(0).into(),
            ],
        )?;
        Ok(())
    }

    /// Takes the rollouts and trials whose driver did not renew its claim by `free_ms`, and renews those of `driver`.
    pub(crate) fn claim_runs(
        &mut self,
        driver: &str,
        free_ms: i64,
        until_ms: i64,
    ) -> Result<Vec<(String, i64)>, StoreError> {
        let rows = self.query(
            "UPDATE runs SET driver = $1, driven_until_ms = $2 WHERE ended_ms IS NULL \
             AND (driver = $1 OR driven_until_ms < $3) RETURNING kind, id",
            &[driver.into(), until_ms.into(), free_ms.into()],
        )?;
        let read = |row: &Row| Ok((row.get("kind")?, row.get("id")?));
        rows.iter().map(read).collect()
    }
}

fn kept_run(row: &Row) -> Result<KeptRun, StoreError> {
    Ok(KeptRun {
        id: row.get("id")?,
        who: row.get("who")?,
        begun_ms: row.get("begun_ms")?,
        ended_ms: row.get("ended_ms")?,
        run: serde_json::from_str(&row.get::<String>("state")?)?,
        left_out: Vec::new(),
        unsaved: false,
    })
}

impl Store {
    /// Claims made before this time may be taken over at `now_ms`. A SQLite file has one hub: no other drives anything.
    pub(crate) fn claims_free_before(&self, now_ms: i64) -> i64 {
        match self.0.kind {
            Kind::Sqlite => i64::MAX,
            Kind::Postgres => now_ms,
        }
    }

    /// What is desired of nodes with higher revisions than `after`.
    pub(crate) async fn desired_after(
        &self,
        after: i64,
    ) -> Result<Vec<(String, i64, DesiredSetting)>, StoreError> {
        let text = "SELECT * FROM desired WHERE revision > $1";
        let rows = self.query(text, vec![after.into()]).await?;
        let read = |row: &Row| -> Result<_, StoreError> {
            let row = DesiredRow::try_from(row)?;
            Ok((row.node, row.revision, row.setting))
        };
        rows.iter().map(read).collect()
    }

    /// What became of a change at each node.
    pub(crate) async fn change_nodes(&self, revision: i64) -> Result<Vec<ChangeNode>, StoreError> {
        let text = "SELECT * FROM order_nodes WHERE revision = $1 ORDER BY node";
        let rows = self.query(text, vec![revision.into()]).await?;
        rows.iter().map(ChangeNode::try_from).collect()
    }

    /// Orders whose outcome is open at some nodes.
    pub(crate) async fn open_order_nodes(&self) -> Result<Vec<ChangeNode>, StoreError> {
        let text = format!("SELECT * FROM order_nodes WHERE {OPEN}");
        let rows = self.query(text, Vec::new()).await?;
        rows.iter().map(ChangeNode::try_from).collect()
    }

    /// The newest changes below revision `before`; those of one node only, if it is given.
    pub(crate) async fn changes(
        &self,
        before: i64,
        node: Option<&str>,
        limit: i64,
    ) -> Result<Vec<ChangeRow>, StoreError> {
        let text = "SELECT * FROM orders WHERE revision < $1 \
                    AND ($2 = '' OR revision IN (SELECT revision FROM order_nodes WHERE node = $2)) \
                    ORDER BY revision DESC LIMIT $3";
        let values = vec![before.into(), node.unwrap_or_default().into(), limit.into()];
        let rows = self.query(text, values).await?;
        rows.iter().map(ChangeRow::try_from).collect()
    }

    /// How many nodes have which outcome, by change, from revision `from` to `to`.
    pub(crate) async fn outcome_counts(
        &self,
        from: i64,
        to: i64,
    ) -> Result<HashMap<i64, Counts>, StoreError> {
        let text = "SELECT revision, outcome, count(*) AS nodes FROM order_nodes \
                    WHERE revision BETWEEN $1 AND $2 GROUP BY revision, outcome";
        let mut found: HashMap<i64, Counts> = HashMap::new();
        for row in self.query(text, vec![from.into(), to.into()]).await? {
            let nodes: i64 = row.get("nodes")?;
            let counts = found.entry(row.get("revision")?).or_default();
            counts.insert(row.get("outcome")?, usize::try_from(nodes).unwrap_or(0));
        }
        Ok(found)
    }

    /// The newest rollouts or trials with numbers below `before`.
    pub(crate) async fn runs(
        &self,
        kind: &str,
        before: i64,
        limit: i64,
    ) -> Result<Vec<KeptRun>, StoreError> {
        let text = "SELECT * FROM runs WHERE kind = $1 AND id < $2 ORDER BY id DESC LIMIT $3";
        let values = vec![kind.into(), before.into(), limit.into()];
        self.query(text, values)
            .await?
            .iter()
            .map(kept_run)
            .collect()
    }

    /// The rollouts and trials that have not ended, whichever hub drives them.
    pub(crate) async fn open_runs(&self) -> Result<Vec<KeptRun>, StoreError> {
        let text = "SELECT * FROM runs WHERE ended_ms IS NULL";
        self.query(text, Vec::new())
            .await?
            .iter()
            .map(kept_run)
            .collect()
    }

    /// One rollout or trial.
    pub(crate) async fn run(&self, kind: &str, id: i64) -> Result<Option<KeptRun>, StoreError> {
        let found = self.runs(kind, id.saturating_add(1), 1).await?;
        Ok(found.into_iter().find(|kept| kept.id == id))
    }

    /// The figures over the clips of each window, by node.
    pub(crate) async fn clip_sums(
        &self,
        windows: &[&Window],
    ) -> Result<HashMap<String, Figures>, StoreError> {
        const DAY_MS: i64 = 86_400_000;
        let sums = Figure::ALL.map(|figure| {
            let of = expression(figure);
            format!(
                "count({of}) AS clips_{figure}, \
                 COALESCE(sum({of}), CAST(0 AS DOUBLE PRECISION)) AS sum_{figure}"
            )
        });
        // A clip is filed under its begin, which lies less than a day before it is received if anybody is to decide
        // on it: without that bound every clip ever received would be looked at.
        let given = match self.0.kind {
            Kind::Sqlite => {
                "SELECT value ->> 'node' AS node, value ->> 'knob' AS knob, value ->> 'value' AS value, \
                 value ->> 'from_ms' AS from_ms, value ->> 'until_ms' AS until_ms FROM json_each($1)"
            }
            Kind::Postgres => {
                "SELECT * FROM jsonb_to_recordset($1::jsonb) \
                 AS given (node text, knob text, value text, from_ms bigint, until_ms bigint)"
            }
        };
        let statement = format!(
            "WITH w AS ({given}) SELECT n.name AS node, {} FROM w \
             JOIN nodes n ON n.name = w.node JOIN cameras k ON k.node_id = n.id \
             JOIN clips c ON c.camera_id = k.id AND c.at_ms >= w.from_ms - {DAY_MS} \
             JOIN setups s ON s.id = c.setup_id WHERE s.knob = w.knob AND s.value = w.value \
             AND c.received_ms >= w.from_ms AND c.received_ms <= w.until_ms \
             AND c.threshold_changed = 0 GROUP BY n.name",
            sums.join(", ")
        );
        let mut found = HashMap::new();
        // A connection that reads is not held for long.
        for windows in windows.chunks(500) {
            let values = vec![serde_json::to_string(windows)?.into()];
            for row in self.query(statement.as_str(), values).await? {
                let mut figures = Figures::new();
                for figure in Figure::ALL {
                    let clips: i64 = row.get(&format!("clips_{figure}"))?;
                    let sum = row.get(&format!("sum_{figure}"))?;
                    let clips = clips.unsigned_abs();
                    if clips > 0 {
                        figures.insert(figure, Mean { clips, sum });
                    }
                }
                found.insert(row.get("node")?, figures);
            }
        }
        Ok(found)
    }
}

/// A figure of a clip; null where the clip does not have it. Partly metered energy (quality 1) is in none.
const fn expression(figure: Figure) -> &'static str {
    match figure {
        Figure::SkipRate => {
            "CAST(c.frames_e + c.frames_p - c.degraded AS DOUBLE PRECISION) / NULLIF(c.frames, 0)"
        }
        Figure::JoulesMeasured => {
            "CASE WHEN c.quality = 0 THEN CAST(c.energy_uj AS DOUBLE PRECISION) / 1000000 END"
        }
        Figure::JoulesEstimated => {
            "CASE WHEN c.quality = 2 THEN CAST(c.energy_uj AS DOUBLE PRECISION) / 1000000 END"
        }
        Figure::EdpMeasured => "CASE WHEN c.quality = 0 THEN c.edp END",
        Figure::EdpEstimated => "CASE WHEN c.quality = 2 THEN c.edp END",
        Figure::LatencyP99 => "CAST(c.latency_p99_us AS DOUBLE PRECISION) / 1000",
        Figure::Degraded => "CAST(c.degraded AS DOUBLE PRECISION) / NULLIF(c.frames, 0)",
        Figure::Recall => "CAST(c.audit_paired AS DOUBLE PRECISION) / NULLIF(c.audit_detected, 0)",
        Figure::Precision => "CAST(c.audit_paired AS DOUBLE PRECISION) / NULLIF(c.audit_shown, 0)",
    }
}
