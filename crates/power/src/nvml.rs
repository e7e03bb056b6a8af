//! NVIDIA graphics cards, through NVML, which is part of their driver and is loaded at run time.
//!
//! Uses the cards' energy counters if all cards have one (Volta and later), else their power. Jetson boards have an
//! NVML that loads but answers "not supported" to every power query: there, this meter is missing and the board's own
//! monitors are the right source.

mod driver;

use crate::condition::combined;
use crate::counter::Counter;
use crate::error::MeterError;
use crate::meter::Meter;
use crate::reading::{Domain, Rail, Reading, Value};
use albireo_wire::BoardState;
use std::path::Path;
use std::sync::Arc;
use tokio::time::Instant;

/// Joules per count of a card's energy counter, which counts millijoules.
const UNIT: f64 = 1e-3;

/// The cards as the driver shows them: `Ok(None)` if a card does not have the value, an error if it cannot be read
/// now.
trait Cards: Send {
    /// The number of cards.
    fn count(&self) -> Result<u32, String>;
    /// The name of a card.
    fn name(&self, card: u32) -> Option<String>;
    /// Energy since the driver was loaded, millijoules.
    fn energy_mj(&self, card: u32) -> Result<Option<u64>, String>;
    /// Power now, milliwatts.
    fn power_mw(&self, card: u32) -> Result<Option<u32>, String>;
    /// Temperature, throttling and clock.
    fn condition(&self, card: u32) -> BoardState;
}

#[derive(Debug)]
struct Card {
    index: u32,
    energy: Counter,
}

/// The NVIDIA cards of this machine.
pub(crate) struct Nvml {
    cards: Vec<Card>,
    /// True if all cards count energy.
    count: bool,
    driver: Box<dyn Cards>,
}

impl Nvml {
    /// Loads NVML and queries each card once.
    ///
    /// # Errors
    /// [`MeterError::Missing`] if there is no driver or no card, or if no card reports its power.
    pub(crate) fn open() -> Result<Self, MeterError> {
        let driver = driver::load(driver::LIBRARY).map_err(MeterError::missing)?;
        Self::with(Box::new(driver))
    }

    fn with(driver: Box<dyn Cards>) -> Result<Self, MeterError> {
        let count = driver.count().map_err(MeterError::missing)?;
        let (mut cards, mut all_count) = (Vec::new(), true);
        for index in 0..count {
            let counts = matches!(driver.energy_mj(index), Ok(Some(_)));
            let power = driver.power_mw(index);
            if !counts && power.map_err(|reason| unreadable(index, reason))?.is_none() {
                continue;
            }
            all_count &= counts;
            let name = driver.name(index).unwrap_or_else(|| "card".to_owned());
            let name = format!("{index} {name}");
            cards.push(Card {
                index,
                energy: Counter::new(name.into(), UNIT, u64::MAX),
            });
        }
        if cards.is_empty() {
            return Err(MeterError::missing(match count {
                0 => "there is a driver, but no card",
                _ => {
                    "NVML loads, but no card reports its power (as on Jetson boards: use ina or tegrastats there)"
                }
            }));
        }
        Ok(Self {
            cards,
            count: all_count,
            driver,
        })
    }
}

fn unreadable(card: u32, reason: String) -> MeterError {
    MeterError::unreadable(Path::new(&format!("card {card}")), reason)
}

impl Meter for Nvml {
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let mut rails = Vec::with_capacity(self.cards.len());
        let mut sum = 0.0;
        let value = match self.count {
            true => Value::Counter,
            false => Value::Power,
        };
        for card in &mut self.cards {
            let read = match self.count {
                true => (self.driver.energy_mj(card.index))
                    .map(|raw| raw.map(|raw| card.energy.update(now, raw))),
                false => (self.driver.power_mw(card.index))
                    .map(|milliwatts| milliwatts.map(|milliwatts| f64::from(milliwatts) * 1e-3)),
            };
            let lost = || "it no longer reports its power".to_owned();
            let read = read.and_then(|read| read.ok_or_else(lost));
            let read = read.map_err(|reason| unreadable(card.index, reason))?;
            sum += read;
            rails.push(Rail {
                name: Arc::clone(&card.energy.name),
                domain: Some(Domain::Gpu),
                in_total: true,
                value: value(read),
            });
        }
        Ok(vec![Reading {
            at: None,
            values: [Some(value(sum)), Some(value(sum)), None, None],
            total_from: "sum_of_rails: graphics cards only".into(),
            rails,
        }])
    }

    fn condition(&mut self) -> BoardState {
        self.cards
            .iter()
            .map(|card| self.driver.condition(card.index))
            .fold(BoardState::default(), combined)
    }
}

#[cfg(test)]
mod tests;
