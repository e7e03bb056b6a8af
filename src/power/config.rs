//! The `[power]` section of the configuration.

use super::meter::MeterError;
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

impl PowerConfig {
    /// Refuses impossible values.
    ///
    /// # Errors
    /// [`MeterError::Configuration`] that names the key and what is allowed.
    pub fn check(&self) -> Result<(), MeterError> {
        let refuse = |text: String| Err(MeterError::Configuration(text));
        if !(10..=10_000).contains(&self.interval_ms) {
            return refuse(format!(
                "interval_ms = {}: must be 10 to 10000",
                self.interval_ms
            ));
        }
        if !(self.idle_watts.is_finite() && self.idle_watts >= 0.0) {
            return refuse(format!(
                "idle_watts = {}: must be a number, 0 or more",
                self.idle_watts
            ));
        }
        if !(self.busy_watts.is_finite() && self.busy_watts >= self.idle_watts) {
            return refuse(format!(
                "busy_watts = {}: must be a number, at least idle_watts ({})",
                self.busy_watts, self.idle_watts
            ));
        }
        Ok(())
    }
}
