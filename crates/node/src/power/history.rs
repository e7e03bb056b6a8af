//! The bounded memory of samples, and the energy of a span of it.

use super::integrate;
use super::reading::{Domain, Reading, Value, Values};
use albireo_wire::{DomainEnergy, DomainWatts, EnergyQuality};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Longest gap between two samples that is bridged, seconds.
const LONGEST_GAP_S: f64 = 1.0;

/// Coverage from which a span counts as covered.
const FULL_COVERAGE: f64 = 0.999;

/// Energy of the node over a span of time.
#[derive(Clone, Debug, PartialEq)]
pub struct SpanEnergy {
    /// The source's name: `rapl`, `estimate`, …
    pub source: String,
    /// How far to trust it.
    pub quality: EnergyQuality,
    /// How the total came about.
    pub total_from: String,
    /// Samples of the total inside the span.
    pub samples: u64,
    /// Share of the span that samples of the total cover, 0 to 1.
    pub coverage: f64,
    /// Joules, mean and peak watts by domain; a domain without any covered time is left out. The mean is
    /// over the covered time. Where energy is counted, the peak is the highest mean between two samples.
    pub domains: Vec<DomainEnergy>,
}

impl SpanEnergy {
    /// No figure: nothing was sampled.
    pub fn unavailable(source: &str) -> Self {
        Self {
            source: source.to_owned(),
            quality: EnergyQuality::Unavailable,
            total_from: String::new(),
            samples: 0,
            coverage: 0.0,
            domains: Vec::new(),
        }
    }

    /// Joules of `domain`, if it has any covered time.
    pub fn joules(&self, domain: Domain) -> Option<f64> {
        self.domains
            .iter()
            .find(|d| d.domain == domain.as_str())
            .map(|d| d.joules)
    }

    /// Joules of the total domain.
    pub fn total_joules(&self) -> Option<f64> {
        self.joules(Domain::Total)
    }
}

#[derive(Clone, Debug)]
struct Sample {
    at: Instant,
    values: Values,
    total_from: Arc<str>,
}

/// Samples of the last while, oldest first.
#[derive(Debug)]
pub(super) struct History {
    keep: Duration,
    samples: VecDeque<Sample>,
    /// Which parts each domain has ever had: a part that is missing later is a gap and not a zero.
    has_watts: [bool; 4],
    has_joules: [bool; 4],
}

impl History {
    pub(super) fn new(keep: Duration) -> Self {
        Self {
            keep,
            samples: VecDeque::new(),
            has_watts: [false; 4],
            has_joules: [false; 4],
        }
    }

    /// Adds a sample; one that is not later than the last is dropped, so that times always rise.
    pub(super) fn push(&mut self, at: Instant, reading: &Reading) {
        if self.samples.back().is_some_and(|last| last.at >= at) {
            return;
        }
        for (i, domain) in Domain::ALL.into_iter().enumerate() {
            let value = reading.values.get(domain);
            self.has_watts[i] |= value.watts.is_some();
            self.has_joules[i] |= value.joules.is_some();
        }
        self.samples.push_back(Sample {
            at,
            values: reading.values,
            total_from: Arc::clone(&reading.total_from),
        });
        while self
            .samples
            .front()
            .is_some_and(|first| at.duration_since(first.at) > self.keep)
        {
            self.samples.pop_front();
        }
    }

    pub(super) fn newest(&self) -> Option<Instant> {
        self.samples.back().map(|s| s.at)
    }

    /// Energy over `[start, end]`; `quality` is that of the meter.
    pub(super) fn energy(
        &self,
        start: Instant,
        end: Instant,
        source: &str,
        quality: EnergyQuality,
    ) -> SpanEnergy {
        let length = end.saturating_duration_since(start).as_secs_f64();
        if length <= 0.0 {
            return SpanEnergy::unavailable(source);
        }
        let near = self.near(start, end);
        let seconds = |at: Instant| signed_seconds(start, at);
        let mut domains = Vec::new();
        let mut coverage = 0.0;
        let mut least = 1.0_f64;
        for (i, domain) in Domain::ALL.into_iter().enumerate() {
            let part = |of: fn(Value) -> Option<f64>| {
                near.clone()
                    .filter_map(move |s| Some((seconds(s.at), of(s.values.get(domain))?)))
            };
            let mut joules = 0.0;
            let mut covered: Option<f64> = None;
            let mut take = |integral: integrate::Integral| {
                joules += integral.joules;
                covered = Some(covered.map_or(integral.covered_s, |c| c.min(integral.covered_s)));
            };
            if self.has_watts[i] {
                take(integrate::power(
                    part(|v| v.watts),
                    0.0,
                    length,
                    LONGEST_GAP_S,
                ));
            }
            if self.has_joules[i] {
                take(integrate::counter(
                    part(|v| v.joules),
                    0.0,
                    length,
                    LONGEST_GAP_S,
                ));
            }
            let Some(covered) = covered else { continue };
            let share = (covered / length).clamp(0.0, 1.0);
            least = least.min(share);
            if domain == Domain::Total {
                coverage = share;
            }
            if covered > 0.0 {
                domains.push(DomainEnergy {
                    domain: domain.as_str().to_owned(),
                    joules,
                    mean_watts: joules / covered,
                    peak_watts: self.peak(domain, start, end),
                });
            }
        }
        let inside = near.clone().filter(|s| s.at >= start && s.at <= end);
        let samples = inside
            .filter(|s| s.values.get(Domain::Total) != Value::default())
            .count();
        SpanEnergy {
            source: source.to_owned(),
            quality: if coverage <= 0.0 {
                EnergyQuality::Unavailable
            } else if quality == EnergyQuality::Measured && least < FULL_COVERAGE {
                EnergyQuality::Partial
            } else {
                quality
            },
            total_from: rules(near),
            samples: samples as u64,
            coverage,
            domains,
        }
    }

    /// Power now by domain: the newest sample, unless it is too old to speak of now.
    pub(super) fn watts(&self, now: Instant) -> Vec<DomainWatts> {
        let Some(newest) = self.samples.back() else {
            return Vec::new();
        };
        if signed_seconds(newest.at, now) > LONGEST_GAP_S {
            return Vec::new();
        }
        let last = self.samples.len() - 1;
        Domain::ALL
            .into_iter()
            .filter_map(|domain| {
                Some(DomainWatts {
                    domain: domain.as_str().to_owned(),
                    watts: self.watts_at(last, domain)?,
                })
            })
            .collect()
    }

    /// The samples of the span and, on both sides, those up to a gap away and one more: all that can
    /// matter. The one more tells the edge of what is known from the edge of a long gap.
    fn near(&self, start: Instant, end: Instant) -> impl Iterator<Item = &Sample> + Clone {
        let gap = Duration::from_secs_f64(LONGEST_GAP_S);
        let first = self.samples.partition_point(|s| s.at + gap < start);
        let last = self.samples.partition_point(|s| s.at <= end + gap);
        let last = (last + 1).min(self.samples.len());
        self.samples.range(first.saturating_sub(1)..last)
    }

    /// Highest power of a sample inside the span, watts.
    fn peak(&self, domain: Domain, start: Instant, end: Instant) -> Option<f64> {
        let first = self.samples.partition_point(|s| s.at < start);
        let last = self.samples.partition_point(|s| s.at <= end);
        (first..last)
            .filter_map(|i| self.watts_at(i, domain))
            .reduce(f64::max)
    }

    /// Power of the sample at index `i`: what it reads, plus the mean rise of the counter since the
    /// sample before.
    fn watts_at(&self, i: usize, domain: Domain) -> Option<f64> {
        let sample = self.samples.get(i)?;
        let value = sample.values.get(domain);
        let from_counter = value.joules.and_then(|joules| {
            let before = self.samples.get(i.checked_sub(1)?)?;
            let seconds = signed_seconds(before.at, sample.at);
            Some((joules - before.values.get(domain).joules?) / seconds)
        });
        let d = domain as usize;
        match (value.watts, from_counter) {
            (Some(watts), Some(counted)) => Some(watts + counted),
            (Some(watts), None) if !self.has_joules[d] => Some(watts),
            (None, Some(counted)) if !self.has_watts[d] => Some(counted),
            _ => None,
        }
    }
}

fn signed_seconds(from: Instant, to: Instant) -> f64 {
    if to >= from {
        (to - from).as_secs_f64()
    } else {
        -(from - to).as_secs_f64()
    }
}

/// The rules by which the total came about, in order of appearance.
fn rules<'a>(samples: impl Iterator<Item = &'a Sample>) -> String {
    let mut seen: Vec<&str> = Vec::new();
    for sample in samples {
        if !seen.contains(&&*sample.total_from) {
            seen.push(&sample.total_from);
        }
    }
    seen.join(", then ")
}

#[cfg(test)]
mod tests;
