//! What presence has for the database: nodes that changed, and notices.

use super::state::PresenceState;
use crate::ingest::Numbers;
use crate::store::rows::text;
use crate::store::tables::{EventRow, NodeRow};
use crate::store::{StoreError, Transaction};
use serde_json::json;
use std::collections::HashMap;

/// What is written of a node.
#[derive(Clone, Debug)]
pub(crate) struct NodeNews {
    pub(super) state: PresenceState,
    pub(super) since_ms: i64,
    pub(super) why: String,
    pub(super) heard_ms: Option<i64>,
    pub(super) run: Option<i64>,
    pub(super) started_ns: Option<i64>,
    pub(super) revision: i64,
    /// The full status; absent when it did not change.
    pub(super) status: Option<String>,
}

/// Something about a node that belongs among the events.
#[derive(Clone, Debug)]
pub(crate) struct Notice {
    kind: &'static str,
    node: String,
    reason: String,
    at_ms: i64,
}

impl Notice {
    pub(super) fn new(kind: &'static str, node: &str, reason: &str, at_ms: i64) -> Self {
        Self {
            kind,
            node: text(node),
            reason: text(reason),
            at_ms,
        }
    }
}

/// What is to be written.
#[derive(Debug, Default)]
pub(crate) struct News {
    pub(super) nodes: Vec<(String, NodeNews)>,
    pub(super) notices: Vec<Notice>,
}

impl News {
    /// Writes it; the events to be written with it.
    pub(crate) fn write(
        &self,
        writing: &mut dyn Transaction,
        numbers: &mut Numbers,
        now_ms: i64,
    ) -> Result<Vec<EventRow>, StoreError> {
        let names: Vec<&str> = self.nodes.iter().map(|(name, _)| name.as_str()).collect();
        let ids = numbers.nodes(writing, &names, now_ms)?;
        let mut rows = Vec::with_capacity(self.nodes.len());
        let mut by_id = HashMap::new();
        for (id, (name, node)) in ids.into_iter().zip(&self.nodes) {
            by_id.insert(id, (name, node));
            rows.push(NodeRow {
                id,
                state: node.state.as_str().to_owned(),
                since_ms: node.since_ms,
                why: text(&node.why),
                heard_ms: node.heard_ms,
                run: node.run,
                started_ns: node.started_ns,
                revision: node.revision,
                status: node.status.as_deref().map(text),
            });
        }
        let changed = if rows.is_empty() {
            Vec::new()
        } else {
            writing.update_nodes(&rows)?
        };
        let mut events: Vec<EventRow> = changed
            .into_iter()
            .filter_map(|(id, before)| {
                let (name, node) = by_id.get(&id)?;
                let detail = json!({ "from": before, "to": node.state, "why": node.why });
                Some(EventRow {
                    at_ms: node.since_ms,
                    kind: "node".to_owned(),
                    node: Some((*name).clone()),
                    detail: text(&detail.to_string()),
                })
            })
            .collect();
        events.extend(self.notices.iter().map(|notice| EventRow {
            at_ms: notice.at_ms,
            kind: notice.kind.to_owned(),
            node: Some(notice.node.clone()),
            detail: json!({ "reason": notice.reason }).to_string(),
        }));
        Ok(events)
    }
}
