//! Defines the `[tuning]` section.

use albireo_service::config::Findings;
use serde::{Deserialize, Serialize};

/// The hub's reaction when somebody at a node changes a value that the hub set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LocalChange {
    /// The change stays, and the hub lists it as drift.
    #[default]
    Wins,
    /// The hub sets its value again.
    SetBack,
}

/// The time limit of orders, and the reaction to local changes: the `[tuning]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TuningConfig {
    /// Time that a reachable node has to report a new value before the order counts as timed out, seconds.
    pub apply_within_s: f64,
    /// The reaction to a change at the node.
    pub local_change: LocalChange,
}

impl Default for TuningConfig {
    fn default() -> Self {
        Self {
            apply_within_s: 60.0,
            local_change: LocalChange::Wins,
        }
    }
}

impl TuningConfig {
    pub(super) fn check(&self, findings: &mut Findings) {
        let day = albireo_service::config::DAY_S;
        findings.above_zero("tuning.apply_within_s", self.apply_within_s, day);
    }
}
