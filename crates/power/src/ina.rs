//! The boards' own power monitors, INA3221 and INA238, straight from hwmon in sysfs: no root, no child
//! process (kernel documentation `hwmon/ina3221`, `hwmon/ina238`).
//!
//! INA3221: channels 1 to 3 with `inN_label`, `inN_input` (bus voltage, mV) and `currN_input` (mA); there
//! is no power file, so power is their product. Inputs 4 to 7 are shunt voltages and sums, not rails.
//! JetPack 4 has another driver with other files; there, `tegrastats` is the meter.
//! INA238: `power1_input` (µW); on AGX Thor it measures the board's input, `VIN`.

use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::meter::Meter;
use crate::rails::{RailMap, RailWatts};
use crate::reading::Reading;
use crate::sysfs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::time::Instant;

const SOURCE: &str = "ina";

/// The name of an INA238's only rail where the device tree gives none.
const INPUT: &str = "VIN";

const INA238: &str = "ina238";
const CHIPS: [&str; 2] = ["ina3221", INA238];

#[derive(Debug)]
enum Files {
    /// Bus voltage in millivolts, current in milliamperes.
    VoltageAndCurrent(PathBuf, PathBuf),
    /// Power in microwatts.
    Power(PathBuf),
}

#[derive(Debug)]
struct Channel {
    name: Arc<str>,
    files: Files,
}

impl Channel {
    fn watts(&self) -> Result<f64, MeterError> {
        let number = |path| sysfs::number::<i64>(SOURCE, path).map(|n| n as f64);
        Ok(match &self.files {
            Files::VoltageAndCurrent(voltage, current) => {
                number(voltage)? * number(current)? * 1e-6
            }
            Files::Power(power) => number(power)? * 1e-6,
        })
    }
}

/// The power monitors of this board.
#[derive(Debug)]
pub(crate) struct Ina {
    channels: Vec<Channel>,
    map: RailMap,
}

impl Ina {
    /// Finds the monitors under `{sysfs}/class/hwmon`, where every hwmon driver lists its chips.
    ///
    /// # Errors
    /// [`MeterError::Missing`] where there is none, or none with a rail; [`MeterError::Permission`] and
    /// [`MeterError::Unreadable`] when no rail can be read.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        config.check()?;
        let mut chips = sysfs::entries(&config.sysfs.join("class/hwmon"));
        chips.retain(|chip| kind(chip).is_some());
        let channels: Vec<Channel> = chips.iter().flat_map(|chip| channels(chip)).collect();
        if channels.is_empty() {
            return Err(MeterError::Missing {
                source_name: SOURCE,
                reason: format!(
                    "no ina3221 or ina238 with a named rail under {}/class/hwmon (Jetson boards have them)",
                    config.sysfs.display()
                ),
            });
        }
        let mut meter = Self {
            channels,
            map: RailMap::new(config.rails.as_ref())?,
        };
        meter.poll(Instant::now())?;
        Ok(meter)
    }
}

/// The driver's name for the chip, of those that are read.
fn kind(chip: &Path) -> Option<&'static str> {
    let name = sysfs::text(SOURCE, &chip.join("name")).ok()?;
    CHIPS.into_iter().find(|known| *known == name)
}

fn channels(chip: &Path) -> Vec<Channel> {
    let text = |file: String| sysfs::text(SOURCE, &chip.join(file)).ok();
    if kind(chip) == Some(INA238) {
        let label = ["power1_label", "in1_label", "label"]
            .iter()
            .find_map(|file| text((*file).to_owned()))
            .filter(|label| !label.is_empty());
        return vec![Channel {
            name: label.map_or_else(|| INPUT.into(), Into::into),
            files: Files::Power(chip.join("power1_input")),
        }];
    }
    (1..=3)
        .filter(|i| text(format!("in{i}_enable")).is_none_or(|on| on != "0"))
        .filter_map(|i| Some((i, text(format!("in{i}_label"))?)))
        .filter(|(_, label)| !label.is_empty() && label != "NC" && !label.contains("shunt"))
        .map(|(i, label)| Channel {
            name: label.into(),
            files: Files::VoltageAndCurrent(
                chip.join(format!("in{i}_input")),
                chip.join(format!("curr{i}_input")),
            ),
        })
        .collect()
}

impl Meter for Ina {
    fn source(&self) -> &str {
        SOURCE
    }

    /// A rail that cannot be read now is missing from the reading; if none can be read, that is the error.
    fn poll(&mut self, _now: Instant) -> Result<Vec<Reading>, MeterError> {
        let mut rails = Vec::with_capacity(self.channels.len());
        let mut failed = None;
        for channel in &self.channels {
            match channel.watts() {
                Ok(watts) => rails.push(RailWatts {
                    name: Arc::clone(&channel.name),
                    watts,
                }),
                Err(error) => failed = Some(error),
            }
        }
        match failed {
            Some(error) if rails.is_empty() => Err(error),
            _ => Ok(vec![self.map.reading(&rails)]),
        }
    }
}

#[cfg(test)]
mod tests;
