//! The `[outbox]` section of the configuration.

use serde::{Deserialize, Serialize};

/// How reports wait for the hub, and how they are sent. What is no setting is a field for tests to change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutboxConfig {
    /// Most bytes of the file. What a hub has goes first, then the oldest that wait, counted as lost.
    #[serde(skip)]
    pub max_bytes: u64,
    /// Reports that are gathered before a batch is sent: each batch costs some hundred bytes. While somebody watches the
    /// node at the hub, and at the start, a report is sent at once.
    #[serde(skip)]
    pub gather_reports: usize,
    /// The longest a report waits for others, seconds; 0 sends each at once.
    pub gather_s: u64,
    /// How long a hub may take to answer, milliseconds.
    #[serde(skip)]
    pub answer_timeout_ms: u64,
    /// First pause after a batch that was not acknowledged, milliseconds; it doubles, with jitter.
    #[serde(skip)]
    pub retry_min_ms: u64,
    /// Longest pause, milliseconds.
    #[serde(skip)]
    pub retry_max_ms: u64,
    /// Time between two heartbeats to the hub, seconds.
    #[serde(skip)]
    pub status_s: u64,
}

impl Default for OutboxConfig {
    fn default() -> Self {
        Self {
            max_bytes: 256 << 20,
            gather_reports: 12,
            gather_s: 600,
            answer_timeout_ms: 10_000,
            retry_min_ms: 1000,
            retry_max_ms: 60_000,
            status_s: 30,
        }
    }
}
