//! The `[power]` section of the configuration.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Where power figures come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PowerSource {
    /// The best meter this machine has, else the estimate.
    #[default]
    Auto,
    /// Energy counters of Intel and AMD processors (Linux powercap).
    Rapl,
    /// From CPU utilisation; always marked estimated.
    Estimate,
    /// None: clips carry no energy.
    None,
}

/// Which meter, how often, and what the estimate assumes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PowerConfig {
    /// Which meter.
    pub source: PowerSource,
    /// Milliseconds between samples (paper: 100).
    pub interval_ms: u64,
    /// Where sysfs is mounted.
    pub sysfs: PathBuf,
    /// Where procfs is mounted.
    pub procfs: PathBuf,
    /// Watts the estimate assumes for an idle machine.
    pub idle_watts: f64,
    /// Watts the estimate assumes with all cores busy.
    pub busy_watts: f64,
}

impl Default for PowerConfig {
    fn default() -> Self {
        Self {
            source: PowerSource::Auto,
            interval_ms: 100,
            sysfs: PathBuf::from("/sys"),
            procfs: PathBuf::from("/proc"),
            idle_watts: 5.0,
            busy_watts: 25.0,
        }
    }
}
