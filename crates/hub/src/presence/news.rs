//! What presence has for the database: nodes that changed, and notices.

use crate::store::record::text;
use crate::store::tables::{EventRow, NodeRow};
use crate::store::{StoreError, Transaction};
use serde_json::json;
use std::collections::HashMap;

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
pub struct News {
    pub(super) nodes: Vec<NodeRow>,
    pub(super) notices: Vec<Notice>,
}

impl News {
    /// Writes it; the events to be written with it.
    pub(crate) fn write(
        &self,
        writing: &mut dyn Transaction,
        now_ms: i64,
    ) -> Result<Vec<EventRow>, StoreError> {
        let before = match self.nodes.is_empty() {
            true => HashMap::new(),
            false => writing.update_nodes(&self.nodes, now_ms)?,
        };
        let event = |node: &NodeRow| {
            let detail =
                json!({ "from": before.get(&node.name)?, "to": node.state, "why": node.why });
            Some(EventRow {
                at_ms: node.since_ms,
                kind: "node".to_owned(),
                node: Some(node.name.clone()),
                detail: text(&detail.to_string()),
            })
        };
        let mut events: Vec<EventRow> = self.nodes.iter().filter_map(event).collect();
        events.extend(self.notices.iter().map(|notice| EventRow {
            at_ms: notice.at_ms,
            kind: notice.kind.to_owned(),
            node: Some(notice.node.clone()),
            detail: json!({ "reason": notice.reason }).to_string(),
        }));
        Ok(events)
    }
}
