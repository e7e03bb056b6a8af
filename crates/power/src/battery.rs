//! The battery of a laptop or a UPS, while it discharges (kernel documentation `ABI/testing/sysfs-class-power`).
//!
//! On mains a battery does not tell what the machine uses, so there is no reading then: a clip during
//! which the plug was in is partial. Batteries renew their figures seldom, some once in many seconds.

use super::config::PowerConfig;
use super::error::MeterError;
use super::meter::Meter;
use super::reading::{Domain, INPUT_RAIL, Rail, Reading, Value, Values};
use super::sysfs;
use albireo_wire::EnergyQuality;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::time::Instant;

const SOURCE: &str = "battery";

/// The batteries that supply this machine.
#[derive(Debug)]
pub struct Battery {
    batteries: Vec<(Arc<str>, PathBuf)>,
    input_rail: Arc<str>,
}

impl Battery {
    /// Finds the batteries under `{sysfs}/class/power_supply`.
    ///
    /// # Errors
    /// [`MeterError::Missing`] where there is none, or none that discharges.
    pub fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        config.check()?;
        let root = config.sysfs.join("class/power_supply");
        let batteries: Vec<_> = sysfs::entries(&root)
            .into_iter()
            .filter(|supply| supplies_the_machine(supply))
            .map(|supply| (Arc::from(sysfs::name(&supply)), supply))
            .collect();
        if batteries.is_empty() {
            return Err(MeterError::Missing {
                source_name: SOURCE,
                reason: format!("no battery under {}", root.display()),
            });
        }
        let mut meter = Self {
            batteries,
            input_rail: INPUT_RAIL.into(),
        };
        meter.poll(Instant::now())?;
        Ok(meter)
    }
}

/// A battery or UPS, and not the battery of a mouse.
fn supplies_the_machine(supply: &Path) -> bool {
    let text = |file: &str| sysfs::text(SOURCE, &supply.join(file)).unwrap_or_default();
    matches!(text("type").as_str(), "Battery" | "UPS") && text("scope") != "Device"
}

/// Watts a battery gives. None when it does not discharge.
fn watts(supply: &Path) -> Result<Option<f64>, MeterError> {
    if sysfs::text(SOURCE, &supply.join("status"))? != "Discharging" {
        return Ok(None);
    }
    let micro = |file: &str| -> Result<f64, MeterError> {
        // Some drivers tell a discharge as a negative number.
        Ok(sysfs::number::<f64>(SOURCE, &supply.join(file))?.abs() * 1e-6)
    };
    Ok(Some(match micro("power_now") {
        Ok(watts) => watts,
        Err(_) => micro("current_now")? * micro("voltage_now")?,
    }))
}

impl Meter for Battery {
    fn source(&self) -> &str {
        SOURCE
    }

    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Measured
    }

    fn poll(&mut self, _now: Instant) -> Result<Vec<Reading>, MeterError> {
        let mut rails = Vec::with_capacity(self.batteries.len());
        for (name, supply) in &self.batteries {
            if let Some(watts) = watts(supply)? {
                rails.push(Rail {
                    name: Arc::clone(name),
                    domain: None,
                    in_total: true,
                    value: Value::power(watts),
                });
            }
        }
        if rails.is_empty() {
            return Err(MeterError::Missing {
                source_name: SOURCE,
                reason: "the battery does not discharge: on mains it does not tell what the machine uses"
                    .to_owned(),
            });
        }
        let mut values = Values::default();
        for rail in &rails {
            values.add(Domain::Total, rail.value);
        }
        Ok(vec![Reading {
            at: None,
            values,
            total_from: Arc::clone(&self.input_rail),
            rails,
        }])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Tree(tempfile::TempDir);

    impl Tree {
        fn new(files: &[(&str, &str)]) -> Self {
            let tree = Self(tempfile::tempdir().unwrap());
            for (file, text) in files {
                tree.write(file, text);
            }
            tree
        }

        fn write(&self, file: &str, text: &str) {
            let path = self.0.path().join("class/power_supply").join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, format!("{text}\n")).unwrap();
        }

        fn open(&self) -> Result<Battery, MeterError> {
            Battery::open(&PowerConfig {
                sysfs: self.0.path().to_owned(),
                ..PowerConfig::default()
            })
        }
    }

    fn total(meter: &mut Battery) -> Option<f64> {
        let reading = meter.poll(Instant::now()).unwrap().remove(0);
        reading.values.get(Domain::Total).watts
    }

    #[test]
    fn a_discharging_battery_tells_the_machines_power_and_the_mouses_does_not_count() {
        let tree = Tree::new(&[
            ("AC/type", "Mains"),
            ("BAT0/type", "Battery"),
            ("BAT0/status", "Discharging"),
            ("BAT0/power_now", "11250000"),
            ("hidpp_battery_0/type", "Battery"),
            ("hidpp_battery_0/scope", "Device"),
            ("hidpp_battery_0/status", "Discharging"),
            ("hidpp_battery_0/power_now", "500000"),
        ]);
        assert_eq!(total(&mut tree.open().unwrap()), Some(11.25));
    }

    #[test]
    fn power_is_current_times_voltage_where_it_is_not_told_and_its_sign_does_not_matter() {
        let tree = Tree::new(&[
            ("BAT0/type", "Battery"),
            ("BAT0/status", "Discharging"),
            ("BAT0/current_now", "-1000000"),
            ("BAT0/voltage_now", "12000000"),
        ]);
        let found = total(&mut tree.open().unwrap()).unwrap();
        assert!((found - 12.0).abs() < 1e-9);
    }

    #[test]
    fn on_mains_there_is_no_figure_and_a_word_why() {
        let tree = Tree::new(&[("BAT0/type", "Battery"), ("BAT0/status", "Charging")]);
        let text = tree.open().unwrap_err().to_string();
        assert!(text.contains("does not discharge"), "{text}");
        tree.write("BAT0/status", "Discharging");
        tree.write("BAT0/power_now", "1000000");
        let mut meter = tree.open().unwrap();
        tree.write("BAT0/status", "Full");
        assert!(meter.poll(Instant::now()).is_err());
    }

    #[test]
    fn two_batteries_add_up_and_none_is_told() {
        let tree = Tree::new(&[]);
        assert!(tree.open().unwrap_err().to_string().contains("no battery"));
        for battery in ["BAT0", "ups"] {
            tree.write(
                &format!("{battery}/type"),
                if battery == "ups" { "UPS" } else { "Battery" },
            );
            tree.write(&format!("{battery}/status"), "Discharging");
            tree.write(&format!("{battery}/power_now"), "4000000");
        }
        assert_eq!(total(&mut tree.open().unwrap()), Some(8.0));
    }
}
