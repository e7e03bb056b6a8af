//! The account of a node's energy: samples come in, and what was used between two instants comes out.
//!
//! A measurement holds two copies of the running totals, of its start and of where it ends should nothing more happen,
//! each taken when the first sample after that instant has come. So its length costs no memory.

use crate::attribution::Attribution;
use crate::condition::{Condition, ConditionSum};
use crate::detector_watts::DetectorWatts;
use crate::reading::{Domain, Reading};
use crate::sampler::MeterCost;
use crate::totals::{History, Sample, Totals};
use albireo_wire::{BoardState, DomainEnergy, EnergyQuality, FULL_COVERAGE};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;

/// Energy of the whole node between two instants.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Energy {
    /// The source's name: `rapl`, `estimate`, …
    pub source: String,
    /// Quality of the figures.
    pub quality: EnergyQuality,
    /// How the total came about.
    pub total_from: String,
    /// Samples of the total after the first instant and up to the second.
    pub samples: u64,
    /// Share of the time that samples of the total cover, 0 to 1.
    pub coverage: f64,
    /// Joules, mean and peak watts by domain; a domain without any covered time is left out. Joules and mean are those
    /// of the covered time. Where energy is counted, the peak is the highest mean between two samples.
    pub domains: Vec<DomainEnergy>,
}

impl Energy {
    /// No figure: nothing was sampled.
    pub fn unavailable(source: &str) -> Self {
        Self {
            source: source.to_owned(),
            ..Self::default()
        }
    }

    /// Joules of `domain`, if it has any covered time.
    pub fn joules(&self, domain: Domain) -> Option<f64> {
        let found = self.domains.iter().find(|d| d.domain == domain.as_str());
        found.map(|domain| domain.joules)
    }
}

/// What was used between two instants.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// The whole node's energy.
    pub node: Energy,
    /// Of its total, the camera's joules; those of the covered time.
    pub joules: Option<f64>,
    /// Watts that a running detector adds on this machine; `None` until that is known.
    pub detector_watts: Option<f64>,
    /// Estimate of what the camera's avoided detector calls would have added, joules; `None` without those watts.
    pub saved_joules: Option<f64>,
    /// The state of the board; `None` where nothing is known of it.
    pub board: Option<BoardState>,
}

/// What is noted sample by sample.
#[derive(Clone, Debug, Default)]
struct Notes {
    peaks: [Option<f64>; Domain::ALL.len()],
    rules: Vec<Cow<'static, str>>,
    conditions: ConditionSum,
}

impl Notes {
    fn add(&mut self, sample: &Sample) {
        for (peak, watts) in self.peaks.iter_mut().zip(sample.watts) {
            *peak = [*peak, watts].into_iter().flatten().reduce(f64::max);
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
    /// The totals at the start, once the first sample after it has come.
    from: Option<Totals>,
    /// Where it ends if nothing more happens.
    end: Instant,
    /// The totals there, and what was noted until then; as `from`.
    to: Option<(Totals, Notes)>,
    notes: Notes,
}

impl Open {
    /// Takes note of a sample, which is in `history` already.
    fn sampled(&mut self, sample: &Sample, history: &History) {
        if sample.at < self.start {
            return;
        }
        self.from.get_or_insert_with(|| history.at(self.start));
        if self.to.is_none() && sample.at > self.end {
            self.to = Some((history.at(self.end), self.notes.clone()));
        }
        self.notes.add(sample);
    }
}

/// The account.
#[derive(Debug)]
pub(crate) struct Account {
    pub source: String,
    pub quality: EnergyQuality,
    pub history: History,
    pub cameras: Attribution,
    pub detector: DetectorWatts,
    pub condition: Condition,
    pub cost: MeterCost,
    pub failed_reads: u64,
    open: BTreeMap<u64, Open>,
    next_number: u64,
}

impl Account {
    /// Of a meter that is read every `interval`.
    pub(crate) fn new(source: &str, quality: EnergyQuality, interval: Duration) -> Self {
        Self {
            source: source.to_owned(),
            quality,
            history: History::new(interval),
            cameras: Attribution::default(),
            detector: DetectorWatts::new(interval),
            condition: Condition::default(),
            cost: MeterCost::default(),
            failed_reads: 0,
            open: BTreeMap::new(),
            next_number: 0,
        }
    }

    /// Takes a sample.
    pub(crate) fn sampled(&mut self, at: Instant, reading: &Reading) {
        let cameras = &mut self.cameras;
        if !(self.history).add(at, reading, |joules, seconds| {
            cameras.divide(joules, seconds)
        }) {
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
    pub(crate) fn set_condition(&mut self, condition: Condition) {
        for open in self.open.values_mut() {
            open.notes.conditions.add(&condition);
        }
        self.condition = condition;
    }

    /// Begins a measurement for `camera`; its number.
    pub(crate) fn open(&mut self, camera: u64, start: Instant) -> u64 {
        let mut open = Open {
            camera,
            start,
            from: None,
            end: start,
            to: None,
            notes: Notes::default(),
        };
        // A measurement between two samples and two conditions has those before it.
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

    /// Says where a measurement ends if nothing more happens. It never moves back.
    pub(crate) fn until(&mut self, number: u64, at: Instant) {
        if let Some(open) = self.open.get_mut(&number)
            && at > open.end
        {
            (open.end, open.to) = (at, None);
        }
    }

    /// Forgets a measurement.
    pub(crate) fn forget(&mut self, number: u64) {
        self.open.remove(&number);
    }

    /// Ends a measurement: what was used until `end`, by the samples there are.
    pub(crate) fn close(&mut self, number: u64, end: Instant) -> Option<Measured> {
        let open = self.open.remove(&number)?;
        let known = open.to.filter(|_| open.end == end);
        let (to, notes) = known.unwrap_or_else(|| (self.history.at(end), open.notes));
        let from = open.from.unwrap_or_else(|| self.history.at(open.start));
        let seconds = end.saturating_duration_since(open.start).as_secs_f64();
        let node = self.energy(&from, &to, seconds, &notes);
        let (before, after) = (from.camera(open.camera), to.camera(open.camera));
        let saved_s = after.saved_s - before.saved_s;
        let detector_watts = self.detector.watts();
        Some(Measured {
            joules: (node.coverage > 0.0).then_some(after.joules - before.joules),
            detector_watts,
            saved_joules: detector_watts.map(|watts| watts * saved_s),
            board: notes.conditions.state(),
            node,
        })
    }

    fn energy(&self, from: &Totals, to: &Totals, seconds: f64, notes: &Notes) -> Energy {
        let mut found = Energy::unavailable(&self.source);
        let mut least = 1.0_f64;
        for domain in Domain::ALL {
            let index = domain as usize;
            if !self.history.has(domain) {
                continue;
            }
            let (from, to) = (from.sums[index], to.sums[index]);
            let (joules, covered_s) = (to.joules - from.joules, to.covered_s - from.covered_s);
            let share = match seconds > 0.0 {
                true => (covered_s / seconds).clamp(0.0, 1.0),
                false => 0.0,
            };
            least = least.min(share);
            if domain == Domain::Total {
                found.coverage = share;
            }
            if share > 0.0 {
                found.domains.push(DomainEnergy {
                    domain: domain.as_str().to_owned(),
                    joules,
                    mean_watts: joules / covered_s,
                    peak_watts: notes.peaks[index],
                });
            }
        }
        found.quality = match self.quality {
            _ if found.coverage <= 0.0 => EnergyQuality::Unavailable,
            EnergyQuality::Measured if least < FULL_COVERAGE => EnergyQuality::Partial,
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
