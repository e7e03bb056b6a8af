//! What presence has for the database: nodes that changed, and notices.

use super::state::PresenceState;
use crate::ingest::Numbers;
use crate::store::rows::text;
use crate::store::tables::{EventRow, NodeRow};
use crate::store::{StoreError, Writing};
use serde_json::json;
use std::collections::HashMap;

/// What is written of a node.
#[derive(Clone, Debug)]
pub(crate) struct NodeNews {
    pub(super) state: PresenceState,
    pub(super) since_ms: i64,
    pub(super) why: String,
    pub(super) heard_ms: Option<i64>,
    pub(super) instance: Option<String>,
    pub(super) machine: Option<String>,
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
    /// Writes it; whether there are events.
    pub(crate) async fn write(
        &self,
        writing: &mut Writing<'_>,
        numbers: &mut Numbers,
        now_ms: i64,
    ) -> Result<bool, StoreError> {
        let names = self.nodes.iter().map(|(name, _)| name.as_str());
        numbers.nodes(writing, names, now_ms).await?;
        let mut rows = Vec::with_capacity(self.nodes.len());
        let mut by_id = HashMap::new();
        for (name, node) in &self.nodes {
            let id = numbers.node(name)?;
            by_id.insert(id, (name, node));
            let kept = |value: &Option<String>| value.as_deref().map(text);
            rows.push(NodeRow {
                id,
                state: node.state.as_str().to_owned(),
                since_ms: node.since_ms,
                why: text(&node.why),
                heard_ms: node.heard_ms,
                instance: kept(&node.instance),
                machine: kept(&node.machine),
                started_ns: node.started_ns,
                revision: node.revision,
                status: kept(&node.status),
            });
        }
        let changed = writing.update_nodes(&rows).await?;
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
        writing.events(&events).await?;
        Ok(!events.is_empty())
    }
}
