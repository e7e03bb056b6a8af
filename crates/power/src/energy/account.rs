//! The energy account of a node: takes samples and returns the energy used between two instants.
//!
//! A measurement holds two copies of the running totals: at its start, and at its provisional end. Each is copied when
//! the first sample after that instant arrives, so a measurement of any length uses constant memory.

use crate::energy::attribution::Attribution;
use crate::energy::detector_watts::DetectorWatts;
use crate::energy::totals::{History, Sample, Totals};
use crate::machine::condition::ConditionSum;
use crate::reading::{Domain, PerDomain, Reading};
use albireo_wire::{BoardState, ClipEnergy, DomainEnergy, EnergyQuality, FULL_COVERAGE};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;

/// The energy used between two instants.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// The energy of the camera and of the whole node, without an energy-delay product. Joules and mean watts refer to
    /// the covered time. For a source that counts energy, the peak is the highest mean between two samples.
    pub energy: ClipEnergy,
    /// The watts that a running detector adds on this machine; `None` until known.
    pub detector_watts: Option<f64>,
    /// The board's state; `None` if nothing is known.
    pub board: Option<BoardState>,
}

/// Notes collected from each sample.
#[derive(Clone, Debug, Default)]
struct Notes {
    peaks: PerDomain<Option<f64>>,
    rules: Vec<Cow<'static, str>>,
    conditions: ConditionSum,
}

impl Notes {
    fn add(&mut self, sample: &Sample) {
        for domain in Domain::ALL {
            if let Some(watts) = sample.watts[domain] {
                let peak = self.peaks[domain].unwrap_or(watts);
                self.peaks[domain] = Some(peak.max(watts));
            }
        }
        self.add_rule(sample);
    }

    fn add_rule(&mut self, sample: &Sample) {
        if !self.rules.contains(&sample.total_from) {
            self.rules.push(sample.total_from.clone());
        }
    }
}

#[derive(Debug)]
struct Open {
    camera: u64,
    start: Instant,
    /// The totals at the start; `None` until the first sample after it.
    from: Option<Totals>,
    /// The provisional end, used if nothing more happens.
    end: Instant,
    /// What is known at the provisional end; `None` until the first sample after it.
    to: Option<AtEnd>,
    notes: Notes,
}

#[derive(Debug)]
struct AtEnd {
    totals: Totals,
    notes: Notes,
}

impl Open {
    /// Records a sample that `history` already contains.
    fn sampled(&mut self, sample: &Sample, history: &History) {
        if sample.at < self.start {
            return;
        }
        if self.from.is_none() {
            self.from = Some(history.at(self.start));
        }
        if self.to.is_none() && sample.at > self.end {
            self.to = Some(AtEnd {
                totals: history.at(self.end),
                notes: self.notes.clone(),
            });
        }
        self.notes.add(sample);
    }
}

/// The energy account.
#[derive(Debug)]
pub(crate) struct Account {
    pub source: String,
    pub interval: Duration,
    pub quality: EnergyQuality,
    pub history: History,
    pub cameras: Attribution,
    pub detector: DetectorWatts,
    pub condition: BoardState,
    /// CPU time of reading the meter.
    pub meter_cpu: Duration,
    pub failed_reads: u64,
    open: BTreeMap<u64, Open>,
    next_number: u64,
}

impl Account {
    /// Creates the account of a meter that is read every `interval`.
    pub(crate) fn new(source: &str, quality: EnergyQuality, interval: Duration) -> Self {
        Self {
            source: source.to_owned(),
            interval,
            quality,
            history: History::new(interval),
            cameras: Attribution::default(),
            detector: DetectorWatts::new(interval),
            condition: BoardState::default(),
            meter_cpu: Duration::ZERO,
            failed_reads: 0,
            open: BTreeMap::new(),
            next_number: 0,
        }
    }

    /// Adds a sample.
    pub(crate) fn sampled(&mut self, at: Instant, reading: &Reading) {
        let divide = |joules, seconds| self.cameras.divide(joules, seconds);
        if !self.history.add(at, reading, divide) {
            return;
        }
        self.detector.learn(&self.history);
        if let Some(sample) = self.history.latest() {
            for open in self.open.values_mut() {
                open.sampled(sample, &self.history);
            }
        }
    }

    /// Sets the board's condition.
    pub(crate) fn set_condition(&mut self, condition: BoardState) {
        for open in self.open.values_mut() {
            open.notes.conditions.add(&condition);
        }
        self.condition = condition;
    }

    /// Begins a measurement for `camera` and returns its number.
    pub(crate) fn open(&mut self, camera: u64, start: Instant) -> u64 {
        let mut open = Open {
            camera,
            start,
            from: None,
            end: start,
            to: None,
            notes: Notes::default(),
        };
        // A measurement that lies between two samples or two conditions uses the ones before it.
        open.notes.conditions.add(&self.condition);
        if let Some(sample) = self.history.before(start) {
            open.notes.add_rule(sample);
        }
        for sample in self.history.after(start) {
            open.sampled(sample, &self.history);
        }
        self.next_number += 1;
        self.open.insert(self.next_number, open);
        self.next_number
    }

    /// Sets the provisional end of a measurement. It never moves back.
    pub(crate) fn until(&mut self, number: u64, at: Instant) {
        if let Some(open) = self.open.get_mut(&number)
            && at > open.end
        {
            open.end = at;
            open.to = None;
        }
    }

    /// Drops a measurement.
    pub(crate) fn forget(&mut self, number: u64) {
        self.open.remove(&number);
    }

    /// Ends a measurement and returns the energy used until `end`, from the samples so far.
    pub(crate) fn close(&mut self, number: u64, end: Instant) -> Option<Measured> {
        let open = self.open.remove(&number)?;
        let AtEnd { totals: to, notes } = match open.to {
            // The history may no longer reach back to the end.
            Some(known) if open.end == end => known,
            _ => AtEnd {
                totals: self.history.at(end),
                notes: open.notes,
            },
        };
        let from = match open.from {
            Some(known) => known,
            None => self.history.at(open.start),
        };
        let seconds = end.saturating_duration_since(open.start).as_secs_f64();
        let mut energy = self.energy(&from, &to, seconds, &notes);
        let before = from.camera(open.camera);
        let after = to.camera(open.camera);
        let detector_watts = self.detector.watts();
        if energy.coverage > 0.0 {
            energy.joules = Some(after.joules - before.joules);
        }
        energy.saved_joules_estimated =
            detector_watts.map(|watts| watts * (after.seconds - before.seconds));
        Some(Measured {
            energy,
            detector_watts,
            board: notes.conditions.state(),
        })
    }

    /// Returns the energy of the whole node.
    fn energy(&self, from: &Totals, to: &Totals, seconds: f64, notes: &Notes) -> ClipEnergy {
        let mut found = ClipEnergy {
            source: self.source.clone(),
            ..ClipEnergy::default()
        };
        let mut least_share = 1.0_f64;
        for domain in Domain::ALL {
            // A domain that the source never reads leaves no gap.
            if !self.history.has(domain) {
                continue;
            }
            let from = from.sums[domain];
            let to = to.sums[domain];
            let joules = to.joules - from.joules;
            let covered_s = to.seconds - from.seconds;
            if covered_s <= 0.0 {
                least_share = 0.0;
                continue;
            }
            let share = (covered_s / seconds).min(1.0);
            least_share = least_share.min(share);
            if domain == Domain::Total {
                found.coverage = share;
                found.node_joules = Some(joules);
            }
            found.domains.push(DomainEnergy {
                domain: domain.as_str().to_owned(),
                joules,
                mean_watts: joules / covered_s,
                peak_watts: notes.peaks[domain],
            });
        }
        found.quality = match self.quality {
            _ if found.coverage <= 0.0 => EnergyQuality::Unavailable,
            EnergyQuality::Measured if least_share < FULL_COVERAGE => EnergyQuality::Partial,
            quality => quality,
        };
        found.samples = to.samples - from.samples;
        found.total_from = notes.rules.join(", then ");
        found
    }

    #[cfg(test)]
    pub(crate) fn footprint(&self) -> usize {
        self.history.len() + self.open.len()
    }
}

#[cfg(test)]
mod tests;
