//! Defines the rows of tables. `docs/fleet.md` lists the tables.

use super::read::ReportCounts;
use crate::ingest::Counts;
use serde::{Deserialize, Serialize};

/// An event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct EventRow {
    pub(crate) at_ms: i64,
    pub(crate) kind: String,
    pub(crate) node: Option<String>,
    pub(crate) detail: String,
}

impl EventRow {
    /// An event of a node.
    pub(crate) fn new(at_ms: i64, kind: &str, node: &str, detail: serde_json::Value) -> Self {
        Self {
            at_ms,
            kind: kind.to_owned(),
            node: Some(node.to_owned()),
            detail: detail.to_string(),
        }
    }
}

/// Counts of a node's reports.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ReportCountsRow {
    /// The node's name, if the query returns it.
    #[serde(default, skip_serializing)]
    pub(crate) name: String,
    pub(crate) node_id: i64,
    #[serde(flatten)]
    pub(crate) totals: ReportCounts,
    #[serde(flatten)]
    pub(crate) counts: Counts,
}

/// The setup that a clip was made with; clips with the same setup share its id. A missing text is empty.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub(crate) struct SetupKey {
    pub(crate) policy: String,
    /// Name of the threshold.
    pub(crate) threshold: String,
    /// Its value, as the shortest text that parses to the same number.
    pub(crate) value: String,
    pub(crate) model: String,
    pub(crate) provider: String,
    pub(crate) power_source: String,
    /// The origin of the total energy.
    pub(crate) total_from: String,
}
