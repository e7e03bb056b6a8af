//! Stores changes of presence: rows of nodes, and events.

use super::PresenceState;
use crate::store::row::read_all;
use crate::store::tables::{EventRow, NodeRow};
use crate::store::{Database, StoreError};
use serde::Deserialize;
use serde_json::json;
use std::collections::HashMap;

/// The rows that wait to be written.
#[derive(Debug, Default)]
pub struct News {
    pub(super) nodes: Vec<NodeRow>,
    pub(super) events: Vec<EventRow>,
}

impl News {
    /// Writes the nodes, and returns the events to write with them. If several hubs see the same change of a node, only
    /// one of them writes the event.
    pub(crate) fn write(&self, database: &mut dyn Database) -> Result<Vec<EventRow>, StoreError> {
        #[derive(Deserialize)]
        struct Before {
            name: String,
            state: String,
            since_ms: i64,
        }
        let mut events = self.events.clone();
        if self.nodes.is_empty() {
            return Ok(events);
        }
        let names: Vec<&str> = self.nodes.iter().map(|row| row.name.as_str()).collect();
        let text = "SELECT name, state, since_ms FROM nodes WHERE name IN";
        let before: Vec<Before> = read_all(database.among(text, &names)?)?;
        let before: HashMap<&str, &Before> = (before.iter())
            .map(|node| (node.name.as_str(), node))
            .collect();
        // A node that was forgotten since then stays forgotten.
        let stays = |row: &&NodeRow| {
            (before.get(row.name.as_str()))
                .is_none_or(|node| node.state != "forgotten" || node.since_ms < row.since_ms)
        };
        let rows: Vec<&NodeRow> = self.nodes.iter().filter(stays).collect();
        database.insert(
            "nodes",
            &rows,
            // Columns without a new value keep their old one.
            "ON CONFLICT (name) DO UPDATE SET state = excluded.state, \
             since_ms = CASE WHEN nodes.state = excluded.state THEN nodes.since_ms ELSE excluded.since_ms END, \
             why = excluded.why, heard_ms = COALESCE(excluded.heard_ms, nodes.heard_ms), \
             run = COALESCE(excluded.run, nodes.run), started_ns = COALESCE(excluded.started_ns, nodes.started_ns), \
             revision = excluded.revision, status = COALESCE(excluded.status, nodes.status)",
        )?;
        for row in rows {
            let node = before.get(row.name.as_str());
            let from = node.map_or(PresenceState::Silent.name(), |node| &node.state);
            if from != row.state {
                let detail = json!({ "from": from, "to": row.state, "why": row.why });
                events.push(EventRow::new(row.since_ms, "node", &row.name, detail));
            }
        }
        Ok(events)
    }
}
