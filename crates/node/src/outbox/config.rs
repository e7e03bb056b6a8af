//! The `[outbox]` section of the configuration.

use serde::{Deserialize, Serialize};

/// The settings for keeping and sending reports. Fields that are not settings exist for tests.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutboxConfig {
    /// Longest time a report waits for others, seconds; 0 sends each at once. While somebody watches the node at the
    /// hub, and at the start, reports are always sent at once.
    pub gather_s: u64,
    /// Hours for which the node may reach no hub before that counts as a fault of its uplink.
    pub offline_h: f64,
    /// The time for which due reports may stay unacknowledged before that is a fault of the uplink, milliseconds: some
    /// attempts.
    #[serde(skip)]
    pub patience_ms: u64,
    /// Time limit for a hub's answer, milliseconds.
    #[serde(skip)]
    pub answer_timeout_ms: u64,
    /// First pause after an unacknowledged batch, milliseconds; it doubles, with jitter.
    #[serde(skip)]
    pub retry_min_ms: u64,
    /// Longest pause, milliseconds.
    #[serde(skip)]
    pub retry_max_ms: u64,
}

impl Default for OutboxConfig {
    fn default() -> Self {
        Self {
            gather_s: 600,
            offline_h: 0.0,
            patience_ms: 30_000,
            answer_timeout_ms: 10_000,
            retry_min_ms: 1000,
            retry_max_ms: 60_000,
        }
    }
}
