//! The table of nodes.

use super::{NodeView, PresenceState, TodaysEnergy};
use crate::store::row::{Cell, Columns, FromRow, IntoRow, Row, read_all};
use crate::store::{Database, EventRow, Store, StoreError};
use albireo_wire::NodeStatus;
use serde_json::json;
use std::collections::HashMap;
use std::sync::Arc;

/// The columns of a node that its messages change.
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

impl IntoRow for NodeRow<'_> {
    const TABLE: &'static str = "nodes";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        Ok(vec![
            ("name", self.name.into()),
            ("state", self.state.name().into()),
            ("since_ms", self.since_ms.into()),
            ("why", self.why.into()),
            ("heard_ms", self.heard_ms.into()),
            ("revision", self.revision.into()),
            ("status", Cell::json_or_null(self.status)?),
        ])
    }
}

/// The state of a node that the table has.
struct StateBefore {
    name: String,
    state: String,
    since_ms: i64,
}

impl FromRow for StateBefore {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            name: row.take()?,
            state: row.take()?,
            since_ms: row.take()?,
        })
    }
}

impl FromRow for NodeView {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            node: row.take()?,
            state: row.take_named(PresenceState::named)?,
            since_ms: row.take()?,
            why: row.take()?,
            heard_ms: row.take()?,
            waiting: 0,
            revision: row.take()?,
            today: TodaysEnergy::default(),
            // The status may be of another version of the program; the node will send a new one.
            status: row.take_json::<Option<NodeStatus>>().ok().flatten().map(Arc::new),
            has_reported: row.take::<Option<i64>>()?.is_some(),
        })
    }
}

/// What the clips of a node used today.
struct UsedToday {
    node: String,
    today: TodaysEnergy,
}

impl FromRow for UsedToday {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            node: row.take()?,
            today: TodaysEnergy {
                measured_joules: row.take()?,
                estimated_joules: row.take()?,
                skip_rate: row.take()?,
                recall: row.take()?,
            },
        })
    }
}

impl dyn Database + '_ {
    /// Writes nodes, and returns the events to write with them. If several hubs see the same change of a node, only one
    /// of them writes the event.
    pub(crate) fn write_nodes(&mut self, nodes: &[NodeView]) -> Result<Vec<EventRow>, StoreError> {
        if nodes.is_empty() {
            return Ok(Vec::new());
        }
        let names: Vec<&str> = nodes.iter().map(|node| node.node.as_str()).collect();
        let text = "SELECT name, state, since_ms FROM nodes WHERE name IN";
        let mut before = HashMap::new();
        let rows = self.among(text, &names)?;
        for row in read_all::<StateBefore>(rows)? {
            before.insert(row.name.clone(), row);
        }
        let mut rows = Vec::new();
        let mut events = Vec::new();
        for node in nodes {
            let row = before.get(&node.node);
            // A node that was forgotten since then stays forgotten.
            if let Some(row) = row
                && row.state == "forgotten"
                && row.since_ms >= node.since_ms
            {
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
            let from = match row {
                Some(row) => row.state.as_str(),
                None => PresenceState::Silent.name(),
            };
            if from != node.state.name() {
                let detail = json!({ "from": from, "to": node.state, "why": node.why });
                events.push(EventRow::of(node.since_ms, "node", &node.node, detail));
            }
        }
        self.insert(
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
        let text = "SELECT name, state, since_ms, why, heard_ms, revision, status, r.node_id \
                    FROM nodes LEFT JOIN report_counts r ON r.node_id = id WHERE state <> 'forgotten'";
        read_all(self.query(text, Vec::new()).await?)
    }

    /// True if the list has a node of this name, also of one that no node may have any more.
    pub(crate) async fn has_node(&self, name: &str) -> Result<bool, StoreError> {
        let text = "SELECT id FROM nodes WHERE name = $1 AND state <> 'forgotten'";
        let rows = self.query(text, vec![name.into()]).await?;
        Ok(!rows.is_empty())
    }

    /// The energy and skip rate of the clips of the day that begins at `since_s`, by node.
    pub(crate) async fn today(
        &self,
        since_s: i64,
    ) -> Result<HashMap<String, TodaysEnergy>, StoreError> {
        let text = include_str!("sql/today.sql");
        let rows = self.query(text, vec![since_s.into()]).await?;
        let used: Vec<UsedToday> = read_all(rows)?;
        Ok(used.into_iter().map(|one| (one.node, one.today)).collect())
    }
}
