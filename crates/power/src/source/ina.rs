//! Reads the boards' INA3221 and INA238 power monitors, directly from hwmon in sysfs: no root, no child process
//! (kernel documentation `hwmon/ina3221`, `hwmon/ina238`).
//!
//! INA3221: channels 1 to 3 with `inN_label`, `inN_input` (bus voltage, mV) and `currN_input` (mA). There
//! is no power file, so power is their product. Inputs 4 to 7 are shunt voltages and sums, not rails.
//! JetPack 4 has another driver with other files; use `tegrastats` there.
//! INA238: `power1_input` (µW); on AGX Thor it measures the board's input, `VIN`.

use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::rails::{RailMap, RailWatts};
use crate::reading::{Domain, Reading};
use crate::source::Meter;
use crate::source::sysfs;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::time::Instant;

/// The name of an INA238's only rail if the device tree gives none.
const INPUT: &str = "VIN";

#[derive(Debug)]
struct Channel {
    name: Arc<str>,
    /// Files whose product is the power in microwatts: the power itself, or bus voltage (mV) and current (mA).
    files: Vec<PathBuf>,
}

impl Channel {
    fn watts(&self) -> Result<f64, MeterError> {
        let mut microwatts = 1.0;
        for file in &self.files {
            microwatts *= sysfs::number::<f64>(file)?;
        }
        Ok(microwatts * 1e-6)
    }
}

/// The power monitors of this board.
#[derive(Debug)]
pub(crate) struct Ina {
    channels: Vec<Channel>,
    map: RailMap,
}

impl Ina {
    /// Finds the monitors under `{sysfs}/class/hwmon`, which lists the chips of all hwmon drivers.
    ///
    /// # Errors
    /// [`MeterError::Missing`] if there is no monitor with a rail; [`MeterError::Failed`] if no rail can be
    /// read, or none tells the board's total.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        let chips = sysfs::entries(&config.sysfs.join("class/hwmon"));
        let channels: Vec<Channel> = chips.iter().flat_map(|chip| channels(chip)).collect();
        if channels.is_empty() {
            let reason = format!(
                "no ina3221 or ina238 with a named rail under {}/class/hwmon (Jetson boards have them)",
                config.sysfs.display()
            );
            return Err(MeterError::missing(reason));
        }
        let mut meter = Self {
            channels: distinct(channels),
            map: RailMap::new(config.rails.as_ref())?,
        };
        let readings = meter.poll(Instant::now())?;
        let has_total = |reading: &Reading| reading.value(Domain::Total).is_some();
        if !readings.iter().any(has_total) {
            let rails: Vec<&str> = meter.channels.iter().map(|channel| &*channel.name).collect();
            let reason = format!(
                "it reads {}, but no rail or sum that is the board's whole power (a rail with in*_enable 0 \
                 is switched off; power.rails can name other rails)",
                rails.join(", ")
            );
            return Err(MeterError::Failed(reason));
        }
        Ok(meter)
    }
}

/// The channels with names that differ: a second `VIN` becomes `VIN 2`, which no table counts as the input.
fn distinct(mut channels: Vec<Channel>) -> Vec<Channel> {
    let mut uses: BTreeMap<Arc<str>, u32> = BTreeMap::new();
    for channel in &mut channels {
        let count = uses.entry(Arc::clone(&channel.name)).or_default();
        *count += 1;
        if *count > 1 {
            channel.name = format!("{} {count}", channel.name).into();
        }
    }
    channels
}

/// The rails of a chip; empty if the chip is not a power monitor.
fn channels(chip: &Path) -> Vec<Channel> {
    match words(chip, "name").as_deref() {
        Some("ina238") => {
            let name = ["power1_label", "in1_label", "label"]
                .into_iter()
                .find_map(|file| words(chip, file));
            vec![Channel {
                name: name.map_or_else(|| INPUT.into(), Into::into),
                files: vec![chip.join("power1_input")],
            }]
        }
        Some("ina3221") => (1..=3).filter_map(|number| channel(chip, number)).collect(),
        _ => Vec::new(),
    }
}

/// Channel `number` of an INA3221; `None` if it is switched off, or no rail.
fn channel(chip: &Path, number: u32) -> Option<Channel> {
    let is_off = words(chip, &format!("in{number}_enable")).is_some_and(|on| on == "0");
    let label = words(chip, &format!("in{number}_label"))?;
    if is_off || label == "NC" || label.contains("shunt") {
        return None;
    }
    Some(Channel {
        name: label.into(),
        files: ["in", "curr"].map(|what| chip.join(format!("{what}{number}_input"))).into(),
    })
}

/// The text of a chip's file, if there is any.
fn words(chip: &Path, file: &str) -> Option<String> {
    let text = sysfs::text(&chip.join(file)).ok()?;
    if text.is_empty() { None } else { Some(text) }
}

impl Meter for Ina {
    /// Omits a rail that cannot be read now; fails if none can be read.
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
