//! The `[power]` section of the configuration.

use super::error::MeterError;
use super::rails::RailTable;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Where power figures come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PowerSource {
    /// The best meter this machine has, else the estimate.
    #[default]
    Auto,
    /// Power monitors INA3221 and INA238 of Jetson boards, from sysfs.
    #[serde(alias = "ina3221", alias = "ina238")]
    Ina,
    /// NVIDIA's program of that name on Jetson boards.
    Tegrastats,
    /// Energy counters of Intel and AMD processors (Linux powercap).
    Rapl,
    /// NVIDIA graphics cards, through their driver's NVML.
    Nvml,
    /// The battery of a laptop or a UPS, while it discharges.
    Battery,
    /// Several of `rapl`, `nvml` and `battery` as one; see [`PowerConfig::sum`].
    Sum,
    /// From CPU and GPU utilisation; always marked estimated.
    Estimate,
    /// None: clips carry no energy.
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
            Self::Battery => "battery",
            Self::Sum => "sum",
            Self::Estimate => "estimate",
            Self::None => "none",
        }
    }
}

/// Which meter, how often, where it is found, and what the estimate assumes.
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
    /// The program `tegrastats`: a path, or a name that is looked for in `PATH`.
    pub tegrastats: PathBuf,
    /// Whether `tegrastats` is run by `sudo -n` (sudoers must allow it without a password).
    pub sudo: bool,
    /// The program `nvpmodel`, asked for the power mode of a Jetson board.
    pub nvpmodel: PathBuf,
    /// Indices of the NVIDIA cards whose power counts; empty for all.
    pub nvml_cards: Vec<u32>,
    /// What `source = "sum"` adds up: of `rapl`, `nvml`, `battery`.
    pub sum: Vec<PowerSource>,
    /// The user's own table of rails, in place of the built-in ones.
    pub rails: Option<RailTable>,
    /// Watts the estimate assumes for an idle machine.
    pub idle_watts: f64,
    /// Watts the estimate assumes with all cores busy.
    pub busy_watts: f64,
    /// Watts the estimate adds for an idle GPU, where the GPU's load can be read.
    pub gpu_idle_watts: f64,
    /// Watts the estimate adds for a busy GPU, where the GPU's load can be read.
    pub gpu_busy_watts: f64,
}

impl Default for PowerConfig {
    fn default() -> Self {
        Self {
            source: PowerSource::Auto,
            interval_ms: 100,
            sysfs: PathBuf::from("/sys"),
            procfs: PathBuf::from("/proc"),
            tegrastats: PathBuf::from("tegrastats"),
            sudo: false,
            nvpmodel: PathBuf::from("nvpmodel"),
            nvml_cards: Vec::new(),
            sum: vec![PowerSource::Rapl, PowerSource::Nvml],
            rails: None,
            idle_watts: 5.0,
            busy_watts: 25.0,
            gpu_idle_watts: 1.0,
            gpu_busy_watts: 15.0,
        }
    }
}

impl PowerConfig {
    /// All impossible values: key, and what is wrong with it and what is allowed.
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut found: Vec<(String, String)> = Vec::new();
        let mut add = |key: &str, reason: String| found.push((key.to_owned(), reason));
        if !(10..=10_000).contains(&self.interval_ms) {
            add(
                "interval_ms",
                format!("must be from 10 to 10000, not {}", self.interval_ms),
            );
        }
        let paths = [
            ("sysfs", &self.sysfs),
            ("procfs", &self.procfs),
            ("tegrastats", &self.tegrastats),
            ("nvpmodel", &self.nvpmodel),
        ];
        for (key, path) in paths {
            if path.as_os_str().is_empty() {
                add(key, "is empty; leave the key out instead".to_owned());
            }
        }
        let watts = [
            ("idle_watts", self.idle_watts, "busy_watts", self.busy_watts),
            (
                "gpu_idle_watts",
                self.gpu_idle_watts,
                "gpu_busy_watts",
                self.gpu_busy_watts,
            ),
        ];
        for (idle_key, idle, busy_key, busy) in watts {
            let mut sound = true;
            for (key, value) in [(idle_key, idle), (busy_key, busy)] {
                // Written so that NaN is refused.
                if !(0.0..=1e5).contains(&value) {
                    sound = false;
                    add(
                        key,
                        format!("must be a number from 0 to 100000, not {value}"),
                    );
                }
            }
            if sound && busy < idle {
                add(busy_key, format!("is {busy}, below {idle_key} ({idle})"));
            }
        }
        for (i, source) in self.sum.iter().enumerate() {
            let name = source.as_str();
            if !matches!(
                source,
                PowerSource::Rapl | PowerSource::Nvml | PowerSource::Battery
            ) {
                let reason =
                    format!("`{name}` cannot be added up; list rapl, nvml and battery only");
                add("sum", reason);
            } else if self.sum.iter().take(i).any(|s| s == source) {
                add("sum", format!("`{name}` is there twice"));
            }
        }
        if self.sum.is_empty() {
            add(
                "sum",
                "list at least one of rapl, nvml and battery".to_owned(),
            );
        }
        if let Some(Err(MeterError::Configuration { key, reason })) =
            self.rails.as_ref().map(RailTable::check)
        {
            add(&key, reason);
        }
        found
    }

    /// Refuses impossible values.
    ///
    /// # Errors
    /// [`MeterError::Configuration`] with the first of the [`problems`](Self::problems).
    pub fn check(&self) -> Result<(), MeterError> {
        match self.problems().into_iter().next() {
            Some((key, reason)) => Err(MeterError::Configuration { key, reason }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        let config: PowerConfig = toml::from_str(text).unwrap();
        config.check().unwrap_err().to_string()
    }

    #[test]
    fn the_defaults_are_sound_and_survive_the_file_format() {
        let config = PowerConfig::default();
        config.check().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<PowerConfig>(&text).unwrap(), config);
    }

    #[test]
    fn impossible_values_are_refused_by_key() {
        assert!(
            refused("interval_ms = 1")
                .contains("power.interval_ms: must be from 10 to 10000, not 1")
        );
        assert!(refused("gpu_busy_watts = 0.5").contains("gpu_busy_watts"));
        assert!(refused("idle_watts = nan").contains("idle_watts"));
        assert!(
            refused("sum = [\"rapl\", \"tegrastats\"]").contains("`tegrastats` cannot be added")
        );
        assert!(refused("sum = [\"rapl\", \"rapl\"]").contains("twice"));
        assert!(refused("sum = []").contains("at least one"));
        assert!(refused("tegrastats = \"\"").contains("power.tegrastats: is empty"));
        assert!(refused("[rails]\ngpu = [\"A\"]").contains("power.rails:"));
        assert!(toml::from_str::<PowerConfig>("watt = 3").is_err());
    }

    #[test]
    fn both_monitors_names_mean_the_same_meter() {
        for name in ["ina", "ina3221", "ina238"] {
            let config: PowerConfig = toml::from_str(&format!("source = \"{name}\"")).unwrap();
            assert_eq!(config.source, PowerSource::Ina);
        }
    }
}
