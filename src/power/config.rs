//! The `[power]` section of the configuration.

use super::meter::MeterError;
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
        let pairs = [
            ("idle_watts", self.idle_watts, "busy_watts", self.busy_watts),
            (
                "gpu_idle_watts",
                self.gpu_idle_watts,
                "gpu_busy_watts",
                self.gpu_busy_watts,
            ),
        ];
        for (idle_key, idle, busy_key, busy) in pairs {
            if !(idle.is_finite() && idle >= 0.0) {
                return refuse(format!("{idle_key} = {idle}: must be a number, 0 or more"));
            }
            if !(busy.is_finite() && busy >= idle) {
                return refuse(format!(
                    "{busy_key} = {busy}: must be a number, at least {idle_key} ({idle})"
                ));
            }
        }
        self.check_sum()?;
        self.rails.as_ref().map_or(Ok(()), RailTable::check)
    }

    fn check_sum(&self) -> Result<(), MeterError> {
        let refuse = |text: String| Err(MeterError::Configuration(format!("sum: {text}")));
        for (i, source) in self.sum.iter().enumerate() {
            let name = source.as_str();
            if !matches!(
                source,
                PowerSource::Rapl | PowerSource::Nvml | PowerSource::Battery
            ) {
                return refuse(format!(
                    "`{name}` cannot be added up; it may list rapl, nvml and battery"
                ));
            }
            if self.sum.iter().take(i).any(|s| s == source) {
                return refuse(format!("`{name}` is there twice"));
            }
        }
        if self.sum.is_empty() {
            return refuse("list at least one of rapl, nvml and battery".to_owned());
        }
        Ok(())
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
        assert!(refused("interval_ms = 1").contains("interval_ms = 1: must be 10 to 10000"));
        assert!(refused("gpu_busy_watts = 0.5").contains("gpu_busy_watts"));
        assert!(refused("idle_watts = nan").contains("idle_watts"));
        assert!(
            refused("sum = [\"rapl\", \"tegrastats\"]").contains("`tegrastats` cannot be added")
        );
        assert!(refused("sum = [\"rapl\", \"rapl\"]").contains("twice"));
        assert!(refused("sum = []").contains("at least one"));
        assert!(refused("[rails]\ngpu = [\"A\"]").contains("rails:"));
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
