//! Several meters as one: on a PC the processor's counters and the graphics cards' make the total.
//!
//! No joule is counted twice: if one of the meters tells the whole machine (`psys`, a discharging
//! battery), its total is the total, and the others only tell their domains. Otherwise the totals are
//! added up. Domains are added up: an integrated and a plugged-in GPU are two.

use super::condition::Condition;
use super::error::MeterError;
use super::meter::Meter;
use super::reading::{Domain, INPUT_RAIL, Rail, Reading, Value, Values};
use albireo_wire::EnergyQuality;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// One of the meters, and which domains it has told so far.
struct Member {
    meter: Box<dyn Meter>,
    told: Vec<Domain>,
    whole: bool,
}

/// Several meters as one.
pub struct SumMeter {
    members: Vec<Member>,
    name: String,
}

impl std::fmt::Debug for SumMeter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("SumMeter").field(&self.name).finish()
    }
}

impl SumMeter {
    /// Adds up `meters`, which must measure different things, and asks each once.
    ///
    /// # Errors
    /// That of a meter that cannot be read.
    pub fn new(meters: Vec<Box<dyn Meter>>) -> Result<Self, MeterError> {
        let names: Vec<&str> = meters.iter().map(|m| m.source()).collect();
        let name = format!("sum({})", names.join("+"));
        let mut sum = Self {
            members: meters
                .into_iter()
                .map(|meter| Member {
                    meter,
                    told: Vec::new(),
                    whole: false,
                })
                .collect(),
            name,
        };
        let now = Instant::now();
        for member in &mut sum.members {
            let readings = member.meter.poll(now)?;
            member.learn(readings.last());
        }
        Ok(sum)
    }
}

impl Member {
    fn learn(&mut self, reading: Option<&Reading>) {
        let Some(reading) = reading else { return };
        self.whole = &*reading.total_from == INPUT_RAIL;
        for domain in Domain::ALL {
            if reading.values.get(domain) != Value::default() && !self.told.contains(&domain) {
                self.told.push(domain);
            }
        }
    }
}

impl Meter for SumMeter {
    fn source(&self) -> &str {
        &self.name
    }

    fn quality(&self) -> EnergyQuality {
        let all_measured = self
            .members
            .iter()
            .all(|m| m.meter.quality() == EnergyQuality::Measured);
        if all_measured {
            EnergyQuality::Measured
        } else {
            EnergyQuality::Estimated
        }
    }

    /// A domain of which a member fails to tell its part is left out: it would be too small.
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let mut values = Values::default();
        let mut rails = Vec::new();
        let mut incomplete: Vec<Domain> = Vec::new();
        let mut failed = None;
        let whole = self.members.iter().position(|m| m.whole);
        let mut read = 0;
        for (i, member) in self.members.iter_mut().enumerate() {
            let reading = match member.meter.poll(now) {
                Ok(mut readings) => readings.pop(),
                Err(error) => {
                    failed = Some(error);
                    None
                }
            };
            member.learn(reading.as_ref());
            let in_total = whole.is_none_or(|w| w == i);
            for domain in &member.told {
                if *domain == Domain::Total && !in_total {
                    continue;
                }
                match reading.as_ref().map(|r| r.values.get(*domain)) {
                    Some(value) if value != Value::default() => values.add(*domain, value),
                    _ => incomplete.push(*domain),
                }
            }
            let Some(reading) = reading else { continue };
            read += 1;
            let source = member.meter.source();
            rails.extend(reading.rails.into_iter().map(|rail| Rail {
                name: format!("{source}: {}", rail.name).into(),
                in_total: rail.in_total && in_total,
                ..rail
            }));
        }
        if let (0, Some(error)) = (read, failed) {
            return Err(error);
        }
        for domain in incomplete {
            values.set(domain, Value::default());
        }
        let total_from: Arc<str> = match whole.and_then(|w| self.members.get(w)) {
            Some(member) => format!("input_rail of {}", member.meter.source()).into(),
            None => {
                let parts: Vec<&str> = self.members.iter().map(|m| m.meter.source()).collect();
                format!("sum_of_rails of {}", parts.join(" and ")).into()
            }
        };
        Ok(vec![Reading {
            at: None,
            values,
            total_from,
            rails,
        }])
    }

    fn condition(&mut self) -> Condition {
        self.members
            .iter_mut()
            .map(|m| m.meter.condition())
            .fold(Condition::default(), Condition::and)
    }

    fn other_cpu(&self) -> Duration {
        self.members.iter().map(|m| m.meter.other_cpu()).sum()
    }
}

#[cfg(test)]
mod tests;
