//! NVIDIA graphics cards, through NVML, which is part of their driver and is loaded at run time.
//!
//! Uses the cards' energy counters if all cards have one (Volta and later), else their power. Jetson boards have an
//! NVML that loads but answers "not supported" to every power query: there, this meter is missing and the board's own
//! monitors are the right source.

mod driver;

use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::machine::condition::combined;
use crate::reading::{Domain, Rail, Reading, Value, Values};
use crate::source::Meter;
use crate::source::counter::Counter;
use crate::source::parts;
use albireo_wire::{BoardState, EnergyQuality};
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

/// The error of a card that answered before and answers no longer.
const LOST: &str = "it no longer reports its power";

impl Card {
    /// The energy counted so far.
    fn joules(&mut self, driver: &dyn Cards, now: Instant) -> Result<f64, String> {
        let raw = driver.energy_mj(self.index)?.ok_or(LOST)?;
        Ok(self.energy.update(now, raw))
    }

    /// The energy counted so far if it `counts_energy`, else the present power.
    fn joules_or_watts(
        &mut self,
        counts_energy: bool,
        driver: &dyn Cards,
        now: Instant,
    ) -> Result<f64, String> {
        if counts_energy {
            self.joules(driver, now)
        } else {
            self.watts(driver)
        }
    }

    /// The present power.
    fn watts(&self, driver: &dyn Cards) -> Result<f64, String> {
        let milliwatts = driver.power_mw(self.index)?.ok_or(LOST)?;
        Ok(f64::from(milliwatts) * 1e-3)
    }
}

/// The NVIDIA cards of this machine.
pub(crate) struct Nvml {
    cards: Vec<Card>,
    /// True if all cards count energy.
    counts_energy: bool,
    /// The cards of this machine that are not read.
    unread: usize,
    /// True if another meter reads the processor.
    processor_is_read: bool,
    driver: Box<dyn Cards>,
}

impl Nvml {
    /// Loads NVML and queries each card once.
    ///
    /// # Errors
    /// [`MeterError::Missing`] if there is no driver or no card, or if no card reports its power.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        let driver = driver::load(&config.nvml).map_err(MeterError::missing)?;
        Self::with(Box::new(driver), parts::cards(&config.sysfs))
    }

    /// Like [`open`](Self::open), beside a meter of the processor.
    pub(super) fn beside_processor(config: &PowerConfig) -> Result<Self, MeterError> {
        Ok(Self {
            processor_is_read: true,
            ..Self::open(config)?
        })
    }

    /// The number of cards on this machine: those that are read, and the others.
    pub(super) fn cards_in_all(&self) -> usize {
        self.cards.len() + self.unread
    }

    /// The cards that the total includes, in words.
    pub(super) fn parts(&self) -> String {
        parts::cards_in_words(self.cards.len())
    }

    /// Queries each card of `driver`. The machine has at least `known` cards, which the driver may not all show.
    fn with(driver: Box<dyn Cards>, known: usize) -> Result<Self, MeterError> {
        let shown = driver.count().map_err(MeterError::missing)?;
        let mut cards = Vec::new();
        let mut counts_energy = true;
        for index in 0..shown {
            // Only a counter that answers now is relied on. Of a card without one the power is read.
            let has_counter = matches!(driver.energy_mj(index), Ok(Some(_)));
            if !has_counter {
                let power = driver.power_mw(index).map_err(|reason| unreadable(index, reason))?;
                if power.is_none() {
                    continue;
                }
                counts_energy = false;
            }
            let model = driver.name(index).unwrap_or_else(|| "card".to_owned());
            let name = format!("{index} {model}");
            cards.push(Card {
                index,
                energy: Counter::new(name.into(), UNIT, u64::MAX),
            });
        }
        if cards.is_empty() {
            let reason = if shown == 0 {
                "there is a driver, but no card"
            } else {
                "NVML loads, but no card reports its power (as on Jetson boards: use ina or tegrastats there)"
            };
            return Err(MeterError::missing(reason));
        }
        let in_all = known.max(shown as usize);
        Ok(Self {
            unread: in_all.saturating_sub(cards.len()),
            cards,
            counts_energy,
            processor_is_read: false,
            driver,
        })
    }
}

fn unreadable(card: u32, reason: String) -> MeterError {
    MeterError::unreadable(Path::new(&format!("card {card}")), reason)
}

impl Meter for Nvml {
    fn quality(&self) -> EnergyQuality {
        parts::quality(self.processor_is_read && self.unread == 0)
    }

    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let mut rails = Vec::with_capacity(self.cards.len());
        let mut sum = 0.0;
        // All cards are read in the same way, because only like figures can be added.
        let value_of = if self.counts_energy {
            Value::Counter
        } else {
            Value::Power
        };
        for card in &mut self.cards {
            let figure = card
                .joules_or_watts(self.counts_energy, &*self.driver, now)
                .map_err(|reason| unreadable(card.index, reason))?;
            sum += figure;
            rails.push(Rail {
                name: Arc::clone(&card.energy.name),
                domain: Some(Domain::Gpu),
                in_total: true,
                value: value_of(figure),
            });
        }
        let mut left_out = Vec::new();
        if !self.processor_is_read {
            left_out.push("processor".to_owned());
        }
        left_out.extend(parts::without_cards(self.unread));
        Ok(vec![Reading {
            at: None,
            values: Values {
                total: Some(value_of(sum)),
                gpu: Some(value_of(sum)),
                ..Values::default()
            },
            total_from: parts::total_from(&self.parts(), &left_out).into(),
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
