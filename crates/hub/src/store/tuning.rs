//! Orders, desired values and what became of them; rollouts and trials.

use super::record::{Row, record};
use super::{Kind, Store, StoreError, Transaction};
use albireo_wire::DesiredSetting;
use serde::Serialize;

record! {
    /// What was ordered for some nodes.
    pub(crate) struct OrderRow {
        revision: i64,
        at_ms: i64,
        who: String,
        why: String,
        origin: String,
        selector: String,
        setting: DesiredSetting,
    }
}

record! {
    /// What became of an order at one node.
    pub(crate) struct OrderNodeRow {
        revision: i64,
        node: String,
        /// The node's setting before, if that was known.
        setting_before: Option<DesiredSetting>,
        outcome: String,
        at_ms: i64,
        detail: String,
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

record! {
    /// A rollout or trial as it is kept.
    pub(crate) struct RunRow {
        id: i64,
        kind: String,
        begun_ms: i64,
        ended_ms: Option<i64>,
        who: String,
        state: String,
    }
}

/// The clips of one node and energy quality, summed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ClipSums {
    pub(crate) node: String,
    pub(crate) quality: i64,
    pub(crate) clips: i64,
    /// Of skip rate, joules, EDP, latency, degraded share, recall and precision against the detector: clips that have it,
    /// and their sum.
    pub(crate) figures: [(i64, f64); 7],
}

/// Whose clips are summed: those that a node made with this value in force and that were received in this span.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ClipWindow {
    pub(crate) node: String,
    pub(crate) knob: String,
    pub(crate) value: String,
    pub(crate) from_ms: i64,
    pub(crate) until_ms: i64,
}

const OPEN: &str = "outcome IN ('pending', 'waiting', 'timed_out')";

impl dyn Transaction + '_ {
    /// The next revision: greater than any before, whatever hub gave it, and than `above`.
    pub(crate) fn next_revision(&mut self, above: i64) -> Result<i64, StoreError> {
        let rows = self.query(
            "UPDATE counters SET value = CASE WHEN value < $1 THEN $1 ELSE value END + 1 \
             WHERE name = 'revision' RETURNING value",
            &[above.into()],
        )?;
        only(&rows, "value")
    }

    /// Stores an order and its nodes, and makes what it orders the desired setting where none of a higher revision is.
    pub(crate) fn order(
        &mut self,
        order: &OrderRow,
        nodes: &[OrderNodeRow],
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
    pub(crate) fn outcomes(&mut self, nodes: &[OrderNodeRow]) -> Result<(), StoreError> {
        let update = format!(
            "ON CONFLICT (revision, node) DO UPDATE SET outcome = excluded.outcome, at_ms = excluded.at_ms, \
             detail = excluded.detail WHERE order_nodes.{OPEN}"
        );
        self.upsert_rows("order_nodes", nodes, &update)
    }

    /// Begins a rollout or trial, driven by `driver`. Returns its number.
    pub(crate) fn begin_run(
        &mut self,
        kind: &str,
        who: &str,
        driver: &str,
        now_ms: i64,
        until_ms: i64,
        state: &str,
    ) -> Result<i64, StoreError> {
        let rows = self.query(
            "UPDATE counters SET value = value + 1 WHERE name = $1 RETURNING value",
            &[kind.into()],
        )?;
        let id = only(&rows, "value")?;
        self.execute(
            "INSERT INTO runs (kind, id, begun_ms, who, driver, driven_until_ms, state) \
             VALUES ($1, $2, $3, $4, $5, $6, $7)",
            &[
                kind.into(),
                id.into(),
                now_ms.into(),
                who.into(),
                driver.into(),
                until_ms.into(),
                state.into(),
            ],
        )?;
        Ok(id)
    }

    /// Stores the state of a rollout or trial, if `driver` still drives it.
    pub(crate) fn save_run(
        &mut self,
        kind: &str,
        id: i64,
        driver: &str,
        ended_ms: Option<i64>,
        state: &str,
    ) -> Result<(), StoreError> {
        self.execute(
            "UPDATE runs SET ended_ms = $3, state = $4 WHERE kind = $1 AND id = $2 AND driver = $5",
            &[
                kind.into(),
                id.into(),
                ended_ms.into(),
                state.into(),
                driver.into(),
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

    /// Stores the state of a rollout after a command. `driver` drives it from now on, also one that had ended.
    pub(crate) fn take_run(
        &mut self,
        kind: &str,
        id: i64,
        driver: &str,
        until_ms: i64,
        ended_ms: Option<i64>,
        state: &str,
    ) -> Result<(), StoreError> {
        self.execute(
            "UPDATE runs SET ended_ms = $3, driver = $4, driven_until_ms = $5, state = $6 \
             WHERE kind = $1 AND id = $2",
            &[
                kind.into(),
                id.into(),
                ended_ms.into(),
                driver.into(),
                until_ms.into(),
                state.into(),
            ],
        )?;
        Ok(())
    }
}

fn only(rows: &[Row], column: &str) -> Result<i64, StoreError> {
    match rows.first() {
        Some(row) => row.get(column),
        None => Err(StoreError::Statement(format!(
            "a statement gave no {column}"
        ))),
    }
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

    /// What became of the orders from revision `from` to `to`; of one node only, if it is given.
    pub(crate) async fn order_nodes(
        &self,
        from: i64,
        to: i64,
        node: Option<&str>,
    ) -> Result<Vec<OrderNodeRow>, StoreError> {
        let text = "SELECT * FROM order_nodes WHERE revision BETWEEN $1 AND $2 AND ($3 = '' OR node = $3) \
                    ORDER BY revision DESC, node";
        let values = vec![from.into(), to.into(), node.unwrap_or_default().into()];
        let rows = self.query(text, values).await?;
        rows.iter().map(OrderNodeRow::try_from).collect()
    }

    /// Orders whose outcome is open at some nodes.
    pub(crate) async fn open_order_nodes(&self) -> Result<Vec<OrderNodeRow>, StoreError> {
        let text = format!("SELECT * FROM order_nodes WHERE {OPEN}");
        let rows = self.query(text, Vec::new()).await?;
        rows.iter().map(OrderNodeRow::try_from).collect()
    }

    /// The newest orders below revision `before`; those of one node only, if it is given.
    pub(crate) async fn orders(
        &self,
        before: i64,
        node: Option<&str>,
        limit: i64,
    ) -> Result<Vec<OrderRow>, StoreError> {
        let text = "SELECT * FROM orders WHERE revision < $1 \
                    AND ($2 = '' OR revision IN (SELECT revision FROM order_nodes WHERE node = $2)) \
                    ORDER BY revision DESC LIMIT $3";
        let values = vec![before.into(), node.unwrap_or_default().into(), limit.into()];
        let rows = self.query(text, values).await?;
        rows.iter().map(OrderRow::try_from).collect()
    }

    /// How many nodes have which outcome, by order, from revision `from` to `to`.
    pub(crate) async fn outcome_counts(
        &self,
        from: i64,
        to: i64,
    ) -> Result<Vec<(i64, String, i64)>, StoreError> {
        let text = "SELECT revision, outcome, count(*) AS nodes FROM order_nodes \
                    WHERE revision BETWEEN $1 AND $2 GROUP BY revision, outcome";
        let rows = self.query(text, vec![from.into(), to.into()]).await?;
        let read = |row: &Row| Ok((row.get("revision")?, row.get("outcome")?, row.get("nodes")?));
        rows.iter().map(read).collect()
    }

    /// The newest rollouts or trials with numbers below `before`.
    pub(crate) async fn runs(
        &self,
        kind: &str,
        before: i64,
        limit: i64,
    ) -> Result<Vec<RunRow>, StoreError> {
        let text = "SELECT * FROM runs WHERE kind = $1 AND id < $2 ORDER BY id DESC LIMIT $3";
        let values = vec![kind.into(), before.into(), limit.into()];
        let rows = self.query(text, values).await?;
        rows.iter().map(RunRow::try_from).collect()
    }

    /// The rollouts and trials that have not ended, whichever hub drives them.
    pub(crate) async fn open_runs(&self) -> Result<Vec<RunRow>, StoreError> {
        let text = "SELECT * FROM runs WHERE ended_ms IS NULL";
        let rows = self.query(text, Vec::new()).await?;
        rows.iter().map(RunRow::try_from).collect()
    }

    /// One rollout or trial.
    pub(crate) async fn run(&self, kind: &str, id: i64) -> Result<Option<RunRow>, StoreError> {
        let text = "SELECT * FROM runs WHERE kind = $1 AND id = $2";
        let rows = self.query(text, vec![kind.into(), id.into()]).await?;
        rows.first().map(RunRow::try_from).transpose()
    }

    /// Sums over the clips that had one value in force from begin to end, by node and energy quality.
    pub(crate) async fn clip_sums(
        &self,
        windows: &[ClipWindow],
    ) -> Result<Vec<ClipSums>, StoreError> {
        const DAY_MS: i64 = 86_400_000;
        let figures = [
            "CAST(c.frames_e + c.frames_p - c.degraded AS DOUBLE PRECISION) / NULLIF(c.frames, 0)",
            "CAST(c.energy_uj AS DOUBLE PRECISION) / 1000000",
            "c.edp",
            "CAST(c.latency_p99_us AS DOUBLE PRECISION) / 1000",
            "CAST(c.degraded AS DOUBLE PRECISION) / NULLIF(c.frames, 0)",
            "CAST(c.audit_paired AS DOUBLE PRECISION) / NULLIF(c.audit_detected, 0)",
            "CAST(c.audit_paired AS DOUBLE PRECISION) / NULLIF(c.audit_shown, 0)",
        ];
        let sums: Vec<String> = (figures.iter().enumerate())
            .map(|(i, f)| {
                format!(
                    "count({f}) AS n{i}, COALESCE(sum({f}), CAST(0 AS DOUBLE PRECISION)) AS s{i}"
                )
            })
            .collect();
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
            "WITH w AS ({given}) SELECT n.name AS node, c.quality AS quality, count(*) AS clips, {} FROM w \
             JOIN nodes n ON n.name = w.node JOIN cameras k ON k.node_id = n.id \
             JOIN clips c ON c.camera_id = k.id AND c.at_ms >= w.from_ms - {DAY_MS} \
             JOIN setups s ON s.id = c.setup_id WHERE s.knob = w.knob AND s.value = w.value \
             AND c.received_ms >= w.from_ms AND c.received_ms <= w.until_ms \
             AND c.threshold_changed = 0 GROUP BY n.name, c.quality",
            sums.join(", ")
        );
        let mut found = Vec::new();
        // A connection that reads is not held for long.
        for windows in windows.chunks(500) {
            let values = vec![serde_json::to_string(windows)?.into()];
            for row in self.query(statement.as_str(), values).await? {
                let mut sums = ClipSums {
                    node: row.get("node")?,
                    quality: row.get("quality")?,
                    clips: row.get("clips")?,
                    figures: [(0, 0.0); 7],
                };
                for (i, figure) in sums.figures.iter_mut().enumerate() {
                    let column = |letter: char| format!("{letter}{i}");
                    *figure = (row.get(&column('n'))?, row.get(&column('s'))?);
                }
                found.push(sums);
            }
        }
        Ok(found)
    }
}
