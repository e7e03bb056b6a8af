//! Orders, desired values and what became of them; rollouts and trials.

use super::Writing;
use crate::setting::{OFF, target_of, target_text};
use crate::store::rows::{Key, insert, parameter, row, text};
use crate::store::{Dialect, Store, StoreError};
use albireo_wire::{DesiredSetting, Threshold};
use sqlx::Row as _;
use sqlx::any::AnyRow;

row! {
    /// What was ordered for some nodes: a value of a knob, or a target.
    pub(crate) struct OrderRow {
        revision: i64,
        at_ms: i64,
        who: String,
        why: String,
        origin: String,
        selector: String,
        knob: String,
        value: String,
        target: Option<String>,
    }
}

row! {
    /// What became of an order at one node.
    pub(crate) struct OrderNodeRow {
        revision: i64,
        node: String,
        from_value: Option<String>,
        from_knob: Option<String>,
        from_target: Option<String>,
        outcome: String,
        at_ms: i64,
        detail: String,
    }
}

row! {
    /// What is desired of a node.
    pub(crate) struct DesiredRow {
        node: String,
        revision: i64,
        knob: String,
        value: String,
        target: Option<String>,
    }
}

impl OrderRow {
    /// What was ordered.
    pub(crate) fn setting(&self) -> Result<DesiredSetting, StoreError> {
        setting(self.knob.clone(), &self.value, self.target.as_deref())
    }
}

impl OrderNodeRow {
    /// What the node had before an order of `ordered`.
    pub(crate) fn before(
        &self,
        ordered: DesiredSetting,
    ) -> Result<Option<DesiredSetting>, StoreError> {
        if let Some(target) = &self.from_target {
            return setting(String::new(), "", Some(target)).map(Some);
        }
        // Rows of the first version have no name: it is the order's.
        let own = match ordered {
            DesiredSetting::Threshold(threshold) => Some(threshold.name.to_string()),
            DesiredSetting::Target(_) => None,
        };
        match (self.from_knob.clone().or(own), &self.from_value) {
            (Some(name), Some(value)) => Ok(Some(threshold(&name, value)?)),
            _ => Ok(None),
        }
    }
}

/// A setting in columns: knob, value, target.
pub(crate) fn columns(setting: DesiredSetting) -> (String, String, Option<String>) {
    match setting {
        DesiredSetting::Threshold(threshold) => (
            threshold.name.to_string(),
            threshold.value.to_string(),
            None,
        ),
        DesiredSetting::Target(Some(target)) => {
            (String::new(), String::new(), Some(target_text(target)))
        }
        DesiredSetting::Target(None) => (String::new(), String::new(), Some(OFF.to_owned())),
    }
}

fn setting(name: String, value: &str, target: Option<&str>) -> Result<DesiredSetting, StoreError> {
    match target {
        None => threshold(&name, value),
        Some(OFF) => Ok(DesiredSetting::Target(None)),
        Some(text) => target_of(text)
            .map(|target| DesiredSetting::Target(Some(target)))
            .ok_or_else(|| StoreError::Statement(format!("`{text}` is kept as a target"))),
    }
}

/// A rollout or trial as it is kept.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CampaignRow {
    pub(crate) id: i64,
    pub(crate) kind: String,
    pub(crate) begun_ms: i64,
    pub(crate) ended_ms: Option<i64>,
    pub(crate) who: String,
    pub(crate) state: String,
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

/// Whose clips are summed: node, knob, value, and when they were received.
pub(crate) type ClipWindow = Key<5>;

const OPEN: &str = "outcome IN ('pending', 'waiting', 'timed_out')";
const ORDER_NODE: &str =
    "revision, node, from_value, from_knob, from_target, outcome, at_ms, detail";
const CAMPAIGN: &str = "id, kind, begun_ms, ended_ms, who, state";

impl Writing<'_> {
    /// The next revision: greater than any before, whatever hub gave it, and greater than `reported`.
    pub(crate) async fn next_revision(&mut self, reported: i64) -> Result<i64, StoreError> {
        let query = self.query(
            "UPDATE counters SET value = CASE WHEN value < $1 THEN $1 ELSE value END + 1 \
             WHERE name = 'revision' RETURNING value",
        );
        let row = query
            .bind(reported)
            .fetch_one(&mut *self.transaction)
            .await?;
        Ok(row.try_get("value")?)
    }

    /// Notes an order and its nodes, and makes what it orders the desired setting where none of a higher revision is.
    pub(crate) async fn order(
        &mut self,
        order: OrderRow,
        nodes: &[OrderNodeRow],
    ) -> Result<(), StoreError> {
        let desired: Vec<DesiredRow> = nodes
            .iter()
            .map(|node| DesiredRow {
                node: node.node.clone(),
                revision: order.revision,
                knob: order.knob.clone(),
                value: order.value.clone(),
                target: order.target.clone(),
            })
            .collect();
        let statement = format!(
            "UPDATE order_nodes SET outcome = 'superseded', at_ms = $2 WHERE {OPEN} AND revision < $3 \
             AND node IN (SELECT CAST(r.value ->> 0 AS TEXT) FROM {{ROWS}})"
        );
        let names: Vec<Key<1>> = nodes
            .iter()
            .map(|node| Key([node.node.as_str().into()]))
            .collect();
        let query = self
            .query(&statement)
            .bind(parameter(&names)?)
            .bind(order.at_ms)
            .bind(order.revision);
        query.execute(&mut *self.transaction).await?;
        let statement = insert::<DesiredRow>("desired")
            + " ON CONFLICT (node) DO UPDATE SET revision = excluded.revision, knob = excluded.knob, \
               value = excluded.value, target = excluded.target WHERE excluded.revision > desired.revision";
        self.with(&statement, &desired).await?;
        self.insert("orders", &[order]).await?;
        self.outcomes(nodes).await
    }

    /// Takes a node off the list and drops what is desired of it; its clips and its history stay.
    pub(crate) async fn forget(&mut self, node: &str, now_ms: i64) -> Result<(), StoreError> {
        let open = format!(
            "UPDATE order_nodes SET outcome = 'missed', at_ms = $2, detail = 'the node was forgotten' \
             WHERE node = $1 AND {OPEN}"
        );
        let query = self.query(&open).bind(text(node)).bind(now_ms);
        query.execute(&mut *self.transaction).await?;
        let query = self.query("DELETE FROM desired WHERE node = $1");
        let query = query.bind(text(node));
        query.execute(&mut *self.transaction).await?;
        let query = self.query(
            "UPDATE nodes SET state = 'forgotten', since_ms = $2, status = NULL, heard_ms = NULL WHERE name = $1",
        );
        let query = query.bind(text(node)).bind(now_ms);
        query.execute(&mut *self.transaction).await?;
        Ok(())
    }

    /// Notes what became of orders; what has ended meanwhile, as of a node that was forgotten, stays as it ended.
    pub(crate) async fn outcomes(&mut self, nodes: &[OrderNodeRow]) -> Result<(), StoreError> {
        let update = format!(
            " ON CONFLICT (revision, node) DO UPDATE SET outcome = excluded.outcome, at_ms = excluded.at_ms, \
             detail = excluded.detail WHERE order_nodes.{OPEN}"
        );
        let statement = insert::<OrderNodeRow>("order_nodes") + &update;
        self.with(&statement, nodes).await?;
        Ok(())
    }

    /// Begins a rollout or trial, driven by `driver`. Returns its number.
    pub(crate) async fn begin_campaign(
        &mut self,
        kind: &str,
        who: &str,
        driver: &str,
        now_ms: i64,
        until_ms: i64,
        state: &str,
    ) -> Result<i64, StoreError> {
        let query = self.query(
            "INSERT INTO campaigns (kind, begun_ms, who, driver, driven_until_ms, state) \
             VALUES ($1, $2, $3, $4, $5, $6) RETURNING id",
        );
        let query = query.bind(kind.to_owned()).bind(now_ms).bind(text(who));
        let query = query
            .bind(driver.to_owned())
            .bind(until_ms)
            .bind(text(state));
        Ok(query
            .fetch_one(&mut *self.transaction)
            .await?
            .try_get("id")?)
    }

    /// Keeps the state of a rollout or trial.
    pub(crate) async fn save_campaign(
        &mut self,
        id: i64,
        ended_ms: Option<i64>,
        state: &str,
    ) -> Result<(), StoreError> {
        let query = self.query("UPDATE campaigns SET ended_ms = $2, state = $3 WHERE id = $1");
        let query = query.bind(id).bind(ended_ms).bind(text(state));
        query.execute(&mut *self.transaction).await?;
        Ok(())
    }

    /// Takes the rollouts and trials that nobody drives, and renews those that `driver` does. On SQLite there is one hub, and
    /// whoever drove them before is gone.
    pub(crate) async fn claim_campaigns(
        &mut self,
        driver: &str,
        now_ms: i64,
        until_ms: i64,
    ) -> Result<Vec<i64>, StoreError> {
        let free = match self.dialect {
            Dialect::Sqlite => "$3 = $3",
            Dialect::Postgres => "driven_until_ms < $3",
        };
        let statement = format!(
            "UPDATE campaigns SET driver = $1, driven_until_ms = $2 WHERE ended_ms IS NULL \
             AND (driver = $1 OR {free}) RETURNING id"
        );
        let query = self
            .query(&statement)
            .bind(driver.to_owned())
            .bind(until_ms)
            .bind(now_ms);
        let rows = query.fetch_all(&mut *self.transaction).await?;
        rows.iter().map(|row| Ok(row.try_get("id")?)).collect()
    }

    /// Drives an ended rollout again: its values return.
    pub(crate) async fn reopen_campaign(
        &mut self,
        id: i64,
        driver: &str,
        until_ms: i64,
        state: &str,
    ) -> Result<(), StoreError> {
        let query = self.query(
            "UPDATE campaigns SET ended_ms = NULL, driver = $2, driven_until_ms = $3, state = $4 WHERE id = $1",
        );
        let query = query
            .bind(id)
            .bind(driver.to_owned())
            .bind(until_ms)
            .bind(text(state));
        query.execute(&mut *self.transaction).await?;
        Ok(())
    }
}

impl Store {
    /// What is desired of nodes with higher revisions than `after`.
    pub(crate) async fn desired_after(
        &self,
        after: i64,
    ) -> Result<Vec<(String, i64, DesiredSetting)>, StoreError> {
        let sql = self
            .dialect
            .sql("SELECT node, revision, knob, value, target FROM desired WHERE revision > $1");
        let rows = sqlx::query(sql)
            .bind(after)
            .fetch_all(&self.readers)
            .await?;
        let read = |row: &AnyRow| -> Result<_, StoreError> {
            let value: String = row.try_get("value")?;
            let target: Option<String> = row.try_get("target")?;
            Ok((
                row.try_get("node")?,
                row.try_get("revision")?,
                setting(row.try_get("knob")?, &value, target.as_deref())?,
            ))
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
        let sql = self.dialect.sql(
            &format!("SELECT {ORDER_NODE} FROM order_nodes \
             WHERE revision BETWEEN $1 AND $2 AND ($3 = '' OR node = $3) ORDER BY revision DESC, node"),
        );
        let query = sqlx::query(sql)
            .bind(from)
            .bind(to)
            .bind(node.unwrap_or_default().to_owned());
        query
            .fetch_all(&self.readers)
            .await?
            .iter()
            .map(order_node)
            .collect()
    }

    /// Orders whose outcome is open at some nodes.
    pub(crate) async fn open_order_nodes(&self) -> Result<Vec<OrderNodeRow>, StoreError> {
        let statement = format!("SELECT {ORDER_NODE} FROM order_nodes WHERE {OPEN}");
        let rows = sqlx::query(self.dialect.sql(&statement))
            .fetch_all(&self.readers)
            .await?;
        rows.iter().map(order_node).collect()
    }

    /// The newest orders below revision `before`; those of one node only, if it is given.
    pub(crate) async fn orders(
        &self,
        before: i64,
        node: Option<&str>,
        limit: i64,
    ) -> Result<Vec<OrderRow>, StoreError> {
        let sql = self.dialect.sql(
            "SELECT revision, at_ms, who, why, origin, selector, knob, value, target FROM orders \
             WHERE revision < $1 AND ($2 = '' OR revision IN (SELECT revision FROM order_nodes WHERE node = $2)) \
             ORDER BY revision DESC LIMIT $3",
        );
        let query = sqlx::query(sql)
            .bind(before)
            .bind(node.unwrap_or_default().to_owned())
            .bind(limit);
        let read = |row: &AnyRow| -> Result<_, StoreError> {
            Ok(OrderRow {
                revision: row.try_get("revision")?,
                at_ms: row.try_get("at_ms")?,
                who: row.try_get("who")?,
                why: row.try_get("why")?,
                origin: row.try_get("origin")?,
                selector: row.try_get("selector")?,
                knob: row.try_get("knob")?,
                value: row.try_get("value")?,
                target: row.try_get("target")?,
            })
        };
        query
            .fetch_all(&self.readers)
            .await?
            .iter()
            .map(read)
            .collect()
    }

    /// How many nodes have which outcome, by order, from revision `from` to `to`.
    pub(crate) async fn outcome_counts(
        &self,
        from: i64,
        to: i64,
    ) -> Result<Vec<(i64, String, i64)>, StoreError> {
        let sql = self.dialect.sql(
            "SELECT revision, outcome, count(*) AS nodes FROM order_nodes WHERE revision BETWEEN $1 AND $2 \
             GROUP BY revision, outcome",
        );
        let rows = sqlx::query(sql)
            .bind(from)
            .bind(to)
            .fetch_all(&self.readers)
            .await?;
        let read = |row: &AnyRow| {
            Ok((
                row.try_get("revision")?,
                row.try_get("outcome")?,
                row.try_get("nodes")?,
            ))
        };
        rows.iter().map(read).collect()
    }

    /// The newest rollouts or trials with numbers below `before`.
    pub(crate) async fn campaigns(
        &self,
        kind: &str,
        before: i64,
        limit: i64,
    ) -> Result<Vec<CampaignRow>, StoreError> {
        let statement = format!(
            "SELECT {CAMPAIGN} FROM campaigns WHERE kind = $1 AND id < $2 ORDER BY id DESC LIMIT $3"
        );
        let query = sqlx::query(self.dialect.sql(&statement))
            .bind(kind.to_owned())
            .bind(before)
            .bind(limit);
        query
            .fetch_all(&self.readers)
            .await?
            .iter()
            .map(campaign)
            .collect()
    }

    /// One rollout or trial.
    pub(crate) async fn campaign(&self, id: i64) -> Result<Option<CampaignRow>, StoreError> {
        let statement = format!("SELECT {CAMPAIGN} FROM campaigns WHERE id = $1");
        let row = sqlx::query(self.dialect.sql(&statement))
            .bind(id)
            .fetch_optional(&self.readers)
            .await?;
        row.as_ref().map(campaign).transpose()
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
        let statement = format!(
            "SELECT n.name AS node, CAST(c.quality AS BIGINT) AS quality, count(*) AS clips, {} FROM {{ROWS}} \
             JOIN nodes n ON n.name = CAST(r.value ->> 0 AS TEXT) JOIN cameras k ON k.node_id = n.id \
             JOIN clips c ON c.camera_id = k.id AND c.at_ms >= CAST(r.value ->> 3 AS BIGINT) - {DAY_MS} \
             JOIN setups s ON s.id = c.setup_id \
             WHERE s.knob = CAST(r.value ->> 1 AS TEXT) AND s.value = CAST(r.value ->> 2 AS TEXT) \
             AND c.received_ms >= CAST(r.value ->> 3 AS BIGINT) AND c.received_ms <= CAST(r.value ->> 4 AS BIGINT) \
             AND c.threshold_changed = 0 GROUP BY n.name, c.quality",
            sums.join(", ")
        );
        let mut found = Vec::new();
        // A connection that reads is not held for long.
        for windows in windows.chunks(500) {
            let query = sqlx::query(self.dialect.sql(&statement)).bind(parameter(windows)?);
            for row in query.fetch_all(&self.readers).await? {
                let mut sums = ClipSums {
                    node: row.try_get("node")?,
                    quality: row.try_get("quality")?,
                    clips: row.try_get("clips")?,
                    figures: [(0, 0.0); 7],
                };
                for (i, figure) in sums.figures.iter_mut().enumerate() {
                    let column = |letter: char| format!("{letter}{i}");
                    *figure = (
                        row.try_get(column('n').as_str())?,
                        row.try_get(column('s').as_str())?,
                    );
                }
                found.push(sums);
            }
        }
        Ok(found)
    }
}

fn order_node(row: &AnyRow) -> Result<OrderNodeRow, StoreError> {
    Ok(OrderNodeRow {
        revision: row.try_get("revision")?,
        node: row.try_get("node")?,
        from_value: row.try_get("from_value")?,
        from_knob: row.try_get("from_knob")?,
        from_target: row.try_get("from_target")?,
        outcome: row.try_get("outcome")?,
        at_ms: row.try_get("at_ms")?,
        detail: row.try_get("detail")?,
    })
}

fn campaign(row: &AnyRow) -> Result<CampaignRow, StoreError> {
    Ok(CampaignRow {
        id: row.try_get("id")?,
        kind: row.try_get("kind")?,
        begun_ms: row.try_get("begun_ms")?,
        ended_ms: row.try_get("ended_ms")?,
        who: row.try_get("who")?,
        state: row.try_get("state")?,
    })
}

/// A threshold as it is kept: name and shortest text.
fn threshold(name: &str, value: &str) -> Result<DesiredSetting, StoreError> {
    let number: f64 = value
        .parse()
        .map_err(|_| StoreError::Statement(format!("`{value}` is kept as a value of `{name}`")))?;
    Ok(DesiredSetting::Threshold(Threshold::new(name, number)))
}
