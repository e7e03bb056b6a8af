//! Changes of presence that are to be stored: nodes and notices.

use crate::store::tables::{EventRow, NodeRow};
use crate::store::{Database, StoreError};
use serde_json::json;
use std::collections::HashMap;

/// What is to be written.
#[derive(Debug, Default)]
pub struct News {
    pub(super) nodes: Vec<NodeRow>,
    pub(super) notices: Vec<EventRow>,
}

impl News {
    /// Writes it; the events to be written with it.
    pub(crate) fn write(
        &self,
        writing: &mut dyn Database,
        now_ms: i64,
    ) -> Result<Vec<EventRow>, StoreError> {
        let before = match self.nodes.is_empty() {
            true => HashMap::new(),
            false => writing.update_nodes(&self.nodes, now_ms)?,
        };
        let event = |node: &NodeRow| {
            let detail =
                json!({ "from": before.get(&node.name)?, "to": node.state, "why": node.why });
            Some(EventRow::new(node.since_ms, "node", &node.name, detail))
        };
        let mut events: Vec<EventRow> = self.nodes.iter().filter_map(event).collect();
        events.extend(self.notices.iter().cloned());
        Ok(events)
    }
}
