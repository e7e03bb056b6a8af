//! Fixtures shared by the tests of several meters.

use crate::config::PowerConfig;
use crate::reading::{Reading, Value, Values};
use albireo_wire::ClipEnergy;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A copy of a machine's files: sysfs under `sys`, procfs under `proc`.
pub(crate) struct Tree(tempfile::TempDir);

impl Default for Tree {
    fn default() -> Self {
        Self(tempfile::tempdir().unwrap())
    }
}

impl Tree {
    pub(crate) fn path(&self, file: impl AsRef<Path>) -> PathBuf {
        self.0.path().join(file)
    }

    pub(crate) fn write(&self, file: impl AsRef<Path>, text: impl std::fmt::Display) {
        let path = self.path(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, format!("{text}\n")).unwrap();
    }

    /// A power monitor with up to three rails of (label, mV, mA).
    pub(crate) fn ina3221(&self, chip: &str, rails: &[(&str, i64, i64)]) {
        let chip = Path::new("sys/class/hwmon").join(chip);
        self.write(chip.join("name"), "ina3221");
        for (i, (label, voltage, current)) in (1..).zip(rails) {
            self.write(chip.join(format!("in{i}_label")), label);
            self.write(chip.join(format!("in{i}_input")), voltage);
            self.write(chip.join(format!("curr{i}_input")), current);
        }
    }

    /// A powercap energy counter with its path, name and count in microjoules.
    pub(crate) fn rapl(&self, zone: &str, name: &str, energy: u64) {
        let zone = Path::new("sys/class/powercap").join(zone);
        self.write(zone.join("name"), name);
        self.write(zone.join("max_energy_range_uj"), "262143328850");
        self.write(zone.join("energy_uj"), energy);
    }

    pub(crate) fn config(&self) -> PowerConfig {
        PowerConfig {
            sysfs: self.path("sys"),
            procfs: self.path("proc"),
            tegrastats: self.path("tegrastats"),
            nvml: self.path("libnvidia-ml.so.1"),
            nvpmodel: self.path("nvpmodel"),
            ..PowerConfig::default()
        }
    }
}

pub(crate) fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

pub(crate) fn reading(total: Value) -> Reading {
    Reading {
        at: None,
        values: Values {
            total: Some(total),
            ..Values::default()
        },
        total_from: "sum_of_rails".into(),
        rails: Vec::new(),
    }
}

pub(crate) fn total(energy: &ClipEnergy) -> f64 {
    energy.node_joules.unwrap()
}

#[track_caller]
pub(crate) fn assert_contains(text: impl std::fmt::Display, parts: &[&str]) {
    let text = text.to_string();
    for part in parts {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
}
