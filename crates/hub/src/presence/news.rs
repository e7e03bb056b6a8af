//! Stores changes of presence: rows of nodes, and events.

use super::{NodeView, PresenceState};
use crate::store::row::read_all;
use crate::store::{Database, EventRow, StoreError};
use serde::Deserialize;
use serde_json::json;
use std::collections::HashMap;

/// The rows that wait to be written.
#[derive(Debug, Default)]
pub struct News {
    pub(super) nodes: Vec<NodeView>,
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
        let names: Vec<&str> = self.nodes.iter().map(|node| node.node.as_str()).collect();
        let text = "SELECT name, state, since_ms FROM nodes WHERE name IN";
        let before: Vec<Before> = read_all(database.among(text, &names)?)?;
        let before: HashMap<&str, &Before> = (before.iter())
            .map(|node| (node.name.as_str(), node))
            .collect();
        // A node that was forgotten since then stays forgotten.
        let stays = |node: &&NodeView| {
            (before.get(node.node.as_str()))
                .is_none_or(|row| row.state != "forgotten" || row.since_ms < node.since_ms)
        };
        let nodes: Vec<&NodeView> = self.nodes.iter().filter(stays).collect();
        let rows = nodes.iter().map(|node| {
            json!({
                "name": node.node,
                "state": node.state,
                "since_ms": node.since_ms,
                "why": node.why,
                "heard_ms": node.heard_ms,
                "revision": i64::try_from(node.revision).unwrap_or(i64::MAX),
                "status": node.status,
            })
        });
        database.insert(
            "nodes",
            &rows.collect::<Vec<_>>(),
            // Columns without a new value keep their old one.
            "ON CONFLICT (name) DO UPDATE SET state = excluded.state, \
             since_ms = CASE WHEN nodes.state = excluded.state THEN nodes.since_ms ELSE excluded.since_ms END, \
             why = excluded.why, heard_ms = COALESCE(excluded.heard_ms, nodes.heard_ms), \
             revision = excluded.revision, status = COALESCE(excluded.status, nodes.status)",
        )?;
        for node in nodes {
            let row = before.get(node.node.as_str());
            let from = row.map_or(PresenceState::Silent.name(), |row| &row.state);
            if from != node.state.name() {
                let detail = json!({ "from": from, "to": node.state, "why": node.why });
                events.push(EventRow::new(node.since_ms, "node", &node.node, detail));
            }
        }
        Ok(events)
    }
}
