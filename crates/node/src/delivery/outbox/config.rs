//! Reads the `[outbox]` section of the configuration.

use serde::{Deserialize, Serialize};

/// It says how reports wait for the hub, and how they are sent. Fields that are no settings are there for tests.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutboxConfig {
    /// Most bytes of the file. What a hub has goes first, then the oldest that wait, counted as lost.
    #[serde(skip)]
    pub max_bytes: u64,
    /// The longest a report waits for others, seconds; 0 sends each at once. While somebody watches the node at the hub,
    /// and at the start, a report is sent at once in any case.
    pub gather_s: u64,
    /// A hub may take this long to answer, milliseconds.
    #[serde(skip)]
    pub answer_timeout_ms: u64,
    /// First pause after a batch that was not acknowledged, milliseconds; it doubles, with jitter.
    #[serde(skip)]
    pub retry_min_ms: u64,
    /// Longest pause, milliseconds.
    #[serde(skip)]
    pub retry_max_ms: u64,
}

impl Default for OutboxConfig {
    fn default() -> Self {
        Self {
            max_bytes: 256 << 20,
            gather_s: 600,
            answer_timeout_ms: 10_000,
            retry_min_ms: 1000,
            retry_max_ms: 60_000,
        }
    }
}
