//! One line of `tegrastats`, in any release from L4T R32 to R39.
//!
//! Power is `RAIL current/average` in milliwatts without a unit (R32), with `mW` (R34 to R38), or with a
//! third value, the maximum (R39). Only the first is used: the average runs since the program started.

use crate::condition::{Condition, is_a_sensor};
use crate::rails::RailWatts;
use std::sync::Arc;

/// The figures of one line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TegrastatsLine {
    /// Rails in the order they are printed.
    pub rails: Vec<RailWatts>,
    /// Sensors that are on and their temperatures, °C.
    pub temperatures: Vec<(String, f64)>,
    /// Mean clock of the cores that are on, MHz.
    pub cpu_mhz: Option<f64>,
    /// GPU clock, MHz; the mean of several.
    pub gpu_mhz: Option<f64>,
}

impl TegrastatsLine {
    /// The board's condition, besides power.
    pub fn condition(&self) -> Condition {
        let hottest = self
            .temperatures
            .iter()
            .filter(|(name, _)| is_a_sensor(name))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(name, celsius)| (Arc::from(name.as_str()), *celsius));
        Condition {
            hottest,
            cpu_mhz: self.cpu_mhz,
            gpu_mhz: self.gpu_mhz,
            ..Condition::default()
        }
    }

    /// Reads a line. None for one that is not of `tegrastats`: it must have the memory in use.
    pub fn parse(line: &str) -> Option<Self> {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if !words.contains(&"RAM") {
            return None;
        }
        let mut found = Self::default();
        for (i, word) in words.iter().enumerate() {
            if let Some(temperature) = temperature(word) {
                found.temperatures.push(temperature);
                continue;
            }
            let Some(value) = words.get(i + 1) else { break };
            match *word {
                "CPU" | "cpu" if value.starts_with('[') => found.cpu_mhz = cores(value),
                "GR3D_FREQ" | "GR3D" => found.gpu_mhz = clock(value),
                "NC" => {}
                name if is_name(name) => {
                    if let Some(watts) = watts(value) {
                        found.rails.push(RailWatts {
                            name: name.into(),
                            watts,
                        });
                    }
                }
                _ => {}
            }
        }
        Some(found)
    }
}

fn is_name(word: &str) -> bool {
    word.starts_with(|c: char| c.is_ascii_alphabetic())
        && word.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

/// The first of `2399mW/2399mW`, `5139mW/5139mW/5139mW`, `18401/18525`, `2171mW`, in watts.
fn watts(word: &str) -> Option<f64> {
    let mut parts = word.split('/');
    let current = parts.next()?;
    let rest: Vec<&str> = parts.collect();
    let milliwatts = |text: &str| text.strip_suffix("mW").unwrap_or(text).parse::<i64>().ok();
    // A number alone without a unit is a clock (`APE 150`), and `RAM 1282/62795MB` is no power.
    if rest.len() > 2 || (rest.is_empty() && !current.ends_with("mW")) {
        return None;
    }
    if !rest.iter().all(|text| milliwatts(text).is_some()) {
        return None;
    }
    Some(milliwatts(current)? as f64 / 1e3)
}

/// `cpu@45.6C`, `cpu@52.9C/53.1C`. A sensor that is power-gated reads -256 °C and is left out.
fn temperature(word: &str) -> Option<(String, f64)> {
    let (name, value) = word.split_once('@')?;
    let current = value.split('/').next()?.strip_suffix('C')?;
    let celsius: f64 = current.parse().ok()?;
    (is_name(name) && celsius > -200.0).then(|| (name.to_ascii_lowercase(), celsius))
}

/// `[5%@729,off,7%@1100]`, `[17%,13%]@408`: mean clock of the cores that are on.
fn cores(word: &str) -> Option<f64> {
    let (list, after) = word.trim_start_matches('[').split_once(']')?;
    let clocks = mean(list.split(',').filter_map(clock));
    clocks.or_else(|| after.strip_prefix('@')?.parse().ok())
}

/// `63%@621`, `0%@[1300,1300]`, `@[314,314,314]`; `63%` and `off` say nothing of the clock.
fn clock(word: &str) -> Option<f64> {
    let (_, clock) = word.split_once('@')?;
    let clocks = clock.trim_start_matches('[').trim_end_matches(']');
    mean(clocks.split(',').filter_map(|mhz| mhz.parse().ok()))
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, n), v| (sum + v, n + 1));
    (count > 0).then(|| sum / f64::from(count))
}

#[cfg(test)]
mod tests;
