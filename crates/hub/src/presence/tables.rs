//! The table of nodes.

use super::{NodeView, PresenceState, TodaysEnergy};
use crate::store::row::{Row, read, read_all};
use crate::store::{Database, EventRow, Store, StoreError};
use albireo_wire::NodeStatus;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::HashMap;

/// The columns of a node that its messages change.
#[derive(Serialize)]
struct NodeRow<'a> {
    name: &'a str,
    state: PresenceState,
    since_ms: i64,
    why: &'a str,
    heard_ms: Option<i64>,
    revision: i64,
    /// The last full status; the table keeps the one before it if there is none.
    status: Option<&'a NodeStatus>,
}

impl dyn Database + '_ {
    /// Writes nodes, and returns the events to write with them. If several hubs see the same change of a node, only one
    /// of them writes the event.
    pub(crate) fn write_nodes(&mut self, nodes: &[NodeView]) -> Result<Vec<EventRow>, StoreError> {
        #[derive(Deserialize)]
        struct Before {
            name: String,
            state: String,
            since_ms: i64,
        }
        if nodes.is_empty() {
            return Ok(Vec::new());
        }
        let names: Vec<&str> = nodes.iter().map(|node| node.node.as_str()).collect();
        let text = "SELECT name, state, since_ms FROM nodes WHERE name IN";
        let before: Vec<Before> = read_all(self.among(text, &names)?)?;
        let before: HashMap<&str, &Before> =
            before.iter().map(|node| (node.name.as_str(), node)).collect();
        let mut rows = Vec::new();
        let mut events = Vec::new();
        for node in nodes {
            let row = before.get(node.node.as_str());
            // A node that was forgotten since then stays forgotten.
            if row.is_some_and(|row| row.state == "forgotten" && row.since_ms >= node.since_ms) {
                continue;
            }
            rows.push(NodeRow {
                name: &node.node,
                state: node.state,
                since_ms: node.since_ms,
                why: &node.why,
                heard_ms: node.heard_ms,
                revision: i64::try_from(node.revision).unwrap_or(i64::MAX),
                status: node.status.as_deref(),
            });
            let from = row.map_or(PresenceState::Silent.name(), |row| &row.state);
            if from != node.state.name() {
                let detail = json!({ "from": from, "to": node.state, "why": node.why });
                events.push(EventRow::of(node.since_ms, "node", &node.node, detail));
            }
        }
        self.insert(
            "nodes",
            &rows,
            // Columns without a new value keep their old one.
            "ON CONFLICT (name) DO UPDATE SET state = excluded.state, \
             since_ms = CASE WHEN nodes.state = excluded.state THEN nodes.since_ms ELSE excluded.since_ms END, \
             why = excluded.why, heard_ms = COALESCE(excluded.heard_ms, nodes.heard_ms), \
             revision = excluded.revision, status = COALESCE(excluded.status, nodes.status)",
        )?;
        Ok(events)
    }

    /// Removes a node from the list; its clips and its history stay.
    pub(crate) fn forget_node(&mut self, node: &str, now_ms: i64) -> Result<(), StoreError> {
        self.query(
            "UPDATE nodes SET state = 'forgotten', since_ms = $2, status = NULL, heard_ms = NULL WHERE name = $1",
            &[node.into(), now_ms.into()],
        )?;
        Ok(())
    }

    /// Deletes nodes of which nothing but statuses came, with an event that counts them.
    pub(crate) fn forget_strangers(
        &mut self,
        names: &[String],
        now_ms: i64,
    ) -> Result<(), StoreError> {
        for name in names {
            self.query(
                "DELETE FROM nodes WHERE name = $1 \
                 AND NOT EXISTS (SELECT 1 FROM report_counts r WHERE r.node_id = nodes.id) \
                 AND NOT EXISTS (SELECT 1 FROM cameras c WHERE c.node_id = nodes.id)",
                &[name.as_str().into()],
            )?;
        }
        let detail = json!({ "who": "hub", "nodes": names.len() });
        self.insert_events(&[EventRow {
            at_ms: now_ms,
            kind: "forgotten",
            node: None,
            detail,
        }])
    }
}

impl Store {
    /// The last known state of every node.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn nodes(&self) -> Result<Vec<NodeView>, StoreError> {
        let text = "SELECT name AS node, state, since_ms, why, heard_ms, revision, status, 0 AS waiting, \
                    r.node_id FROM nodes LEFT JOIN report_counts r ON r.node_id = id WHERE state <> 'forgotten'";
        let node = |mut row: Row| {
            row.insert("today".to_owned(), json!(TodaysEnergy::default()));
            let has_reported = row.remove("node_id").is_some_and(|id| !id.is_null());
            row.insert("has_reported".to_owned(), has_reported.into());
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
