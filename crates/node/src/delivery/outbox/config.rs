//! The `[outbox]` section of the configuration.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Bounds and manners of the outbox.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutboxConfig {
    /// Most bytes of reports that wait on disk; beyond it the oldest go first, counted as lost.
    pub max_bytes: u64,
    /// Reports older than this go, counted as lost, days.
    pub max_age_days: u32,
    /// Most reports that wait in memory while nothing can be kept on disk.
    pub memory_reports: usize,
    /// Most reports in one batch.
    pub batch_reports: usize,
    /// Reports that are gathered before a batch is sent: each batch costs some hundred bytes. While somebody watches the
    /// node at the hub, and at the start, a report is sent at once.
    pub gather_reports: usize,
    /// The longest a report waits for others, seconds.
    pub gather_s: u64,
    /// How long a hub may take to answer a batch, milliseconds.
    pub answer_timeout_ms: u64,
    /// First pause after a batch that was not acknowledged, milliseconds; it doubles, with jitter.
    pub retry_min_ms: u64,
    /// Longest pause, milliseconds.
    pub retry_max_ms: u64,
    /// Time between two heartbeats to the hub, seconds.
    pub status_s: u64,
    /// File that identifies the machine: another one begins a new instance.
    pub machine_id: PathBuf,
}

impl Default for OutboxConfig {
    fn default() -> Self {
        Self {
            max_bytes: 256 << 20,
            max_age_days: 90,
            memory_reports: 2000,
            batch_reports: 400,
            gather_reports: 12,
            gather_s: 600,
            answer_timeout_ms: 10_000,
            retry_min_ms: 1000,
            retry_max_ms: 60_000,
            status_s: 30,
            machine_id: "/etc/machine-id".into(),
        }
    }
}
