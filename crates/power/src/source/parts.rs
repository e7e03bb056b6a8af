//! The parts of a PC added up: the processor by RAPL, and its graphics cards by NVML.
//!
//! Neither meter knows the other's part, and none of them is the whole machine: what is added up is named in words, and
//! a part that consumes much and cannot be read makes the figure partial.

use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::reading::{PerDomain, Reading, Value};
use crate::source::Meter;
use crate::source::nvml::Nvml;
use crate::source::rapl::Rapl;
use crate::source::sysfs;
use albireo_wire::{BoardState, EnergyQuality};
use std::path::Path;
use tokio::time::Instant;

/// PCI's number of NVIDIA.
const NVIDIA: &str = "0x10de";

/// The number of NVIDIA cards in PCI's list, whether or not a driver shows them.
pub(super) fn cards(sysfs: &Path) -> usize {
    let devices = sysfs::entries(&sysfs.join("bus/pci/devices"));
    devices.iter().filter(|device| is_card(device)).count()
}

fn is_card(device: &Path) -> bool {
    let begins = |file: &str, prefix: &str| {
        sysfs::text(&device.join(file)).is_ok_and(|text| text.starts_with(prefix))
    };
    // Class 03 is display and 3D controllers; the same card's sound and USB are other classes.
    begins("vendor", NVIDIA) && begins("class", "0x03")
}

/// "card" or "3 cards".
pub(super) fn cards_in_words(count: usize) -> String {
    match count {
        1 => "card".to_owned(),
        _ => format!("{count} cards"),
    }
}

/// The cards that are left out of a figure, in words; `None` for none.
pub(super) fn without_cards(count: usize) -> Option<String> {
    if count == 0 {
        return None;
    }
    Some(cards_in_words(count))
}

/// [`Reading::total_from`] of a sum of parts: "processor, without card".
pub(super) fn total_from(parts: &str, left_out: &[String]) -> String {
    if left_out.is_empty() {
        parts.to_owned()
    } else {
        format!("{parts}, without {}", left_out.join(" and "))
    }
}

/// The quality of a figure that has all parts, or not.
pub(super) const fn quality(is_complete: bool) -> EnergyQuality {
    if is_complete {
        EnergyQuality::Measured
    } else {
        EnergyQuality::Partial
    }
}

/// The processor and the graphics cards of a PC.
pub(crate) struct Parts {
    processor: Rapl,
    cards: Nvml,
    /// The processor's counters at the last poll, for cards that show power and count no energy.
    before: Option<(Instant, PerDomain<Option<Value>>)>,
}

impl Parts {
    /// Opens both meters.
    ///
    /// # Errors
    /// [`MeterError`] of the first that cannot be used: without it there is nothing to add.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        let cards = Nvml::beside_processor(config)?;
        Ok(Self {
            processor: Rapl::beside(config, cards.cards_in_all())?,
            cards,
            before: None,
        })
    }

    /// The mean power of the processor since the last poll.
    fn mean_power(&mut self, now: Instant, processor: &Reading) -> PerDomain<Option<Value>> {
        let before = self.before.replace((now, processor.values));
        PerDomain::each(|domain| {
            let (then, values) = before?;
            let seconds = now.saturating_duration_since(then).as_secs_f64();
            let watts = processor.value(domain)?.mean_watts(values[domain], seconds)?;
            Some(Value::Power(watts))
        })
    }
}

impl Meter for Parts {
    fn quality(&self) -> EnergyQuality {
        self.cards.quality()
    }

    /// Fails if either part cannot be read now: half of a sum is no sum.
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let of_processor = self.processor.poll(now).map_err(|error| error.of("rapl"))?;
        let of_cards = self.cards.poll(now).map_err(|error| error.of("nvml"))?;
        let mut readings = Vec::new();
        // Each gives one reading.
        for (processor, cards) in of_processor.into_iter().zip(of_cards) {
            // As the cards show theirs: only values of one kind can be added.
            let cards_count = matches!(cards.values.total, Some(Value::Counter(_)));
            let values = if cards_count {
                processor.values
            } else {
                self.mean_power(now, &processor)
            };
            readings.push(Reading {
                at: None,
                values: PerDomain {
                    total: sum(values.total, cards.values.total),
                    // The integrated GPU of a processor beside a card, where it has a counter.
                    gpu: sum(values.gpu, cards.values.gpu).or(cards.values.gpu),
                    ..values
                },
                total_from: format!("{} + {}", self.processor.parts(), cards.total_from).into(),
                rails: processor.rails.into_iter().chain(cards.rails).collect(),
            });
        }
        Ok(readings)
    }

    fn condition(&mut self) -> BoardState {
        self.cards.condition()
    }
}

/// The sum of two values of one kind; `None` if one is missing.
fn sum(one: Option<Value>, other: Option<Value>) -> Option<Value> {
    match (one?, other?) {
        (Value::Counter(a), Value::Counter(b)) => Some(Value::Counter(a + b)),
        (Value::Power(a), Value::Power(b)) => Some(Value::Power(a + b)),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
