//! The `[power]` section of the configuration.

use crate::rails::RailTable;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The source of power figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PowerSource {
    /// The best meter on this machine, else the estimate.
    #[default]
    Auto,
    /// INA3221 and INA238 power monitors of Jetson boards, from sysfs.
    #[serde(alias = "ina3221", alias = "ina238")]
    Ina,
    /// NVIDIA's `tegrastats` program on Jetson boards.
    Tegrastats,
    /// Energy counters of Intel and AMD processors (Linux powercap).
    Rapl,
    /// NVIDIA graphics cards, through the driver's NVML.
    Nvml,
    /// The processor's counters and the graphics cards' added up: `rapl` and `nvml`.
    #[serde(rename = "rapl+nvml")]
    Parts,
    /// A program that prints watts, `command`.
    Command,
    /// Estimated from CPU utilisation; always marked estimated.
    Estimate,
    /// No source: clips carry no energy.
    None,
}

impl PowerSource {
    /// The name in the configuration.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Ina => "ina",
            Self::Tegrastats => "tegrastats",
            Self::Rapl => "rapl",
            Self::Nvml => "nvml",
            Self::Parts => "rapl+nvml",
            Self::Command => "command",
            Self::Estimate => "estimate",
            Self::None => "none",
        }
    }
}

/// The meter, its interval, its paths, and the assumptions of the estimate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PowerConfig {
    /// The meter.
    pub source: PowerSource,
    /// Milliseconds between samples (paper: 100).
    pub interval_ms: u64,
    /// The mount point of sysfs. Like `procfs` and `nvpmodel` not a setting: tests read another tree.
    #[serde(skip)]
    pub sysfs: PathBuf,
    /// The mount point of procfs.
    #[serde(skip)]
    pub procfs: PathBuf,
    /// The `tegrastats` program: a path, or a name to look up in `PATH`.
    pub tegrastats: PathBuf,
    /// A shell command that prints lines of a name and watts, for the source `command`.
    pub command: Option<String>,
    /// NVIDIA's library. Like `nvpmodel` not a setting.
    #[serde(skip)]
    pub nvml: PathBuf,
    /// The `nvpmodel` program, which reports the power mode of a Jetson board.
    #[serde(skip)]
    pub nvpmodel: PathBuf,
    /// The user's rail table, which replaces the built-in ones.
    pub rails: Option<RailTable>,
    /// The power that the estimate assumes for an idle machine, watts.
    pub idle_watts: f64,
    /// The power that the estimate assumes with all cores busy, watts.
    pub busy_watts: f64,
}

impl Default for PowerConfig {
    fn default() -> Self {
        Self {
            source: PowerSource::Auto,
            interval_ms: 100,
            sysfs: PathBuf::from("/sys"),
            procfs: PathBuf::from("/proc"),
            tegrastats: PathBuf::from("tegrastats"),
            command: None,
            nvml: PathBuf::from("libnvidia-ml.so.1"),
            nvpmodel: PathBuf::from("nvpmodel"),
            rails: None,
            idle_watts: 5.0,
            busy_watts: 25.0,
        }
    }
}

const EMPTY: &str = "is empty; leave the key out instead";

impl PowerConfig {
    /// Returns all invalid values: the key, and what is wrong and what is allowed.
    pub fn problems(&self) -> Vec<(&'static str, String)> {
        let mut found = Vec::new();
        let mut wrong = |key, reason: String| found.push((key, reason));
        match &self.command {
            Some(command) if command.trim().is_empty() => wrong("command", EMPTY.to_owned()),
            None if self.source == PowerSource::Command => {
                let reason = "is missing: it is the program that prints watts";
                wrong("command", reason.to_owned());
            }
            _ => {}
        }
        let interval = self.interval_ms;
        if !(10..=10_000).contains(&interval) {
            wrong(
                "interval_ms",
                format!("must be from 10 to 10000, not {interval}"),
            );
        }
        if self.tegrastats.as_os_str().is_empty() {
            wrong("tegrastats", EMPTY.to_owned());
        }
        let idle = self.idle_watts;
        let busy = self.busy_watts;
        for (key, watts) in [("idle_watts", idle), ("busy_watts", busy)] {
            // Written so that NaN is rejected.
            if !(0.0..=1e5).contains(&watts) {
                wrong(
                    key,
                    format!("must be a number from 0 to 100000, not {watts}"),
                );
            }
        }
        if busy < idle {
            wrong(
                "busy_watts",
                format!("is {busy}, below idle_watts ({idle})"),
            );
        }
        if let Some(fault) = self.rails.as_ref().and_then(RailTable::fault) {
            wrong("rails", fault);
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::assert_contains;

    #[test]
    fn invalid_values_are_rejected_by_key() {
        let interval = "power.interval_ms: must be from 10 to 10000, not 1";
        let busy = "power.busy_watts: is 0.5, below idle_watts";
        let twice = "power.rails: `A` is counted in two";
        for (text, expected) in [
            ("source = 'command'", "power.command: is missing"),
            ("interval_ms = 1", interval),
            ("busy_watts = 0.5", busy),
            ("idle_watts = nan", "idle_watts"),
            ("tegrastats = ''", "power.tegrastats: is empty"),
            ("[rails]\ngpu = ['A']", "power.rails:"),
            ("[rails]\nsum = ['A']\ngpu = ['A']\ncpu = ['A']", twice),
            ("[rails]\nsum = ['A', 'A']", "twice"),
            ("[rails]", "name the rail"),
        ] {
            let config: PowerConfig = toml::from_str(text).unwrap();
            assert_contains(crate::open(&config).err().unwrap(), &[expected]);
        }
        for unknown in ["watt = 3", "[rails]\nsumm = []"] {
            assert!(toml::from_str::<PowerConfig>(unknown).is_err());
        }
    }

    #[test]
    fn chip_names_select_the_ina_meter() {
        for name in ["ina", "ina3221", "ina238"] {
            let config: PowerConfig = toml::from_str(&format!("source = \"{name}\"")).unwrap();
            assert_eq!(config.source, PowerSource::Ina);
        }
    }
}
