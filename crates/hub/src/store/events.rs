//! The rows of events, which every room adds to its transactions.

use super::row::{Columns, IntoRow};
use super::{Database, StoreError};
use serde_json::Value;

/// An event to insert.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct EventRow {
    /// When, milliseconds since the Unix epoch.
    pub(crate) at_ms: i64,
    pub(crate) kind: &'static str,
    /// The node it is about, if it is about one.
    pub(crate) node: Option<String>,
    /// Details, by kind: a JSON object.
    pub(crate) detail: Value,
}

impl EventRow {
    /// An event of a node.
    pub(crate) fn of(at_ms: i64, kind: &'static str, node: &str, detail: Value) -> Self {
        Self {
            at_ms,
            kind,
            node: Some(node.to_owned()),
            detail,
        }
    }
}

impl IntoRow for EventRow {
    const TABLE: &'static str = "events";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        Ok(vec![
            ("at_ms", self.at_ms.into()),
            ("kind", self.kind.into()),
            ("node", self.node.as_deref().into()),
            ("detail", self.detail.to_string().into()),
        ])
    }
}

impl dyn Database + '_ {
    /// Inserts events, in order.
    pub(crate) fn insert_events(&mut self, events: &[EventRow]) -> Result<(), StoreError> {
        self.insert(events, "")?;
        Ok(())
    }
}
