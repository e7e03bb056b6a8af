//! The `[tuning]` section.

use albireo_service::config::Findings;
use serde::{Deserialize, Serialize};

/// What happens when somebody changes a value at the node that the hub desires otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LocalChange {
    /// It wins, and is shown as drift.
    #[default]
    Wins,
    /// The desired value is set again.
    SetBack,
}

impl LocalChange {
    /// Whether the desired value is set again.
    pub(crate) const fn is_set_back(self) -> bool {
        matches!(self, Self::SetBack)
    }
}

/// How values are set: the `[tuning]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TuningConfig {
    /// How long a node in reach may take to report a value before it counts as timed out, seconds.
    pub apply_within_s: f64,
    /// What happens when a value is changed at the node.
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
