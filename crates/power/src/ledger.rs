//! The account of the node's energy: a span is opened when a clip begins, follows the samples in constant memory
//! however long the clip is, and is closed at the clip's end, which is often known only later.

use super::condition::{Condition, ConditionSum, Conditions};
use super::reading::{Domain, Reading};
use super::series::{Edge, Point, Series, Sums, seconds_between, total};
use super::shares::Shares;
use albireo_wire::{BoardState, DomainEnergy, DomainWatts, EnergyQuality, FULL_COVERAGE};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Rules for the total that one span tells of.
const MOST_RULES: usize = 8;

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
    /// Joules, mean and peak watts by domain; a domain without any covered time is left out. Joules and mean
    /// are those of the covered time. Where energy is counted, the peak is the highest mean between two samples.
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

/// What a closed span used.
#[derive(Clone, Debug, PartialEq)]
pub struct Spent {
    /// The whole node's energy.
    pub node: SpanEnergy,
    /// Of its total, the joules of the span's user; those of the covered time.
    pub joules: Option<f64>,
    /// The state of the board; `None` where it tells nothing.
    pub board: Option<BoardState>,
}

/// Whose figures they are, for what is made of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meta<'a> {
    /// The meter's name.
    pub source: &'a str,
    /// The meter's quality.
    pub quality: EnergyQuality,
}

/// A moment whose sums will be asked for, and the sums once its samples have to go.
#[derive(Clone, Copy, Debug)]
struct Mark {
    at: Instant,
    /// The sums, and the joules of the span's user.
    known: Option<(Sums, f64)>,
}

impl Mark {
    const fn new(at: Instant) -> Self {
        Self { at, known: None }
    }
}

/// What is noted of samples one by one.
#[derive(Clone, Debug, Default)]
struct Tally {
    samples: u64,
    peaks: [Option<f64>; Domain::ALL.len()],
    rules: Vec<Arc<str>>,
    conditions: ConditionSum,
}

impl Tally {
    fn add(&mut self, point: &Point) {
        self.samples += u64::from(point.is_of_the_total());
        for (domain, peak) in Domain::ALL.into_iter().zip(&mut self.peaks) {
            *peak = highest(*peak, point.watts(domain));
        }
        self.add_rule(&point.total_from);
    }

    fn add_rule(&mut self, rule: &Arc<str>) {
        if self.rules.len() < MOST_RULES && !self.rules.contains(rule) {
            self.rules.push(Arc::clone(rule));
        }
    }

    /// Adds what was noted after this.
    fn append(&mut self, later: Self) {
        self.samples += later.samples;
        for (peak, other) in self.peaks.iter_mut().zip(later.peaks) {
            *peak = highest(*peak, other);
        }
        later.rules.iter().for_each(|rule| self.add_rule(rule));
        self.conditions.append(later.conditions);
    }
}

fn highest(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.max(b)),
        (one, None) | (None, one) => one,
    }
}

/// A span that is open. What is noted of it is as much for a second as for a day.
#[derive(Clone, Debug)]
struct Span {
    user: usize,
    start: Mark,
    /// Where it ends if nothing more happens.
    until: Mark,
    /// Of the samples that are forgotten: those up to there, and those after.
    sure: Tally,
    beyond: Tally,
}

impl Span {
    /// What to add a sample of that moment to.
    fn tally(&mut self, at: Instant) -> Option<&mut Tally> {
        if at < self.start.at {
            None
        } else if at <= self.until.at {
            Some(&mut self.sure)
        } else {
            Some(&mut self.beyond)
        }
    }
}

/// The account.
#[derive(Debug)]
pub(super) struct Ledger {
    series: Series,
    conditions: Conditions,
    shares: Shares,
    spans: BTreeMap<u64, Span>,
    next_span: u64,
}

impl Ledger {
    /// An account that begins now, of a meter that is read every `interval`.
    pub(super) fn new(interval: Duration) -> Self {
        Self {
            series: Series::new(interval),
            conditions: Conditions::default(),
            shares: Shares::new(Instant::now()),
            spans: BTreeMap::new(),
            next_span: 0,
        }
    }

    /// Takes a sample; see [`Series::push`].
    pub(super) fn sampled(&mut self, at: Instant, reading: &Reading, regular: bool) {
        self.series.push(at, reading, regular);
        if self.series.newest() == Some(at) {
            self.shares.sampled(at, total(&self.series.sums()));
        }
        while let Some(leaving) = self.series.leaving() {
            self.write_down(leaving);
            if let Some(point) = self.series.forget() {
                for span in self.spans.values_mut() {
                    if let Some(tally) = span.tally(point.at) {
                        tally.add(&point);
                    }
                }
            }
            self.shares.forget(leaving);
        }
    }

    /// Takes a look at the board.
    pub(super) fn looked(&mut self, at: Instant, condition: Condition) {
        for (at, condition) in self.conditions.push(at, condition) {
            for span in self.spans.values_mut() {
                if let Some(tally) = span.tally(at) {
                    tally.conditions.add(&condition);
                }
            }
        }
    }

    /// Works out what will be asked for of the time before `moment`, which is about to be forgotten.
    fn write_down(&mut self, moment: Instant) {
        let Self {
            series,
            shares,
            spans,
            ..
        } = self;
        shares.settle(moment, newest(series));
        for span in spans.values_mut() {
            let user = span.user;
            for (mark, edge) in [(&mut span.start, Edge::Start), (&mut span.until, Edge::End)] {
                if mark.at < moment && mark.known.is_none() {
                    let sums = series.at(mark.at, edge);
                    mark.known = Some((sums, shares.at(user, mark.at, total(&sums))));
                }
            }
        }
    }

    /// The number of the user `name`.
    pub(super) fn user(&mut self, name: &str) -> usize {
        self.shares.user(name)
    }

    /// The number of the user `name` that stands aside.
    pub(super) fn user_aside(&mut self, name: &str) -> usize {
        self.shares.user_aside(name)
    }

    /// Notes a frame of `user`.
    pub(super) fn frame(&mut self, user: usize, at: Instant) {
        self.shares.frame(user, at);
    }

    /// Notes a run of the detector.
    pub(super) fn detector(&mut self, user: usize, start: Instant, end: Instant, used: Duration) {
        self.shares.detector(user, start, end, used);
    }

    /// Opens a span of `user`.
    pub(super) fn open(&mut self, user: usize, start: Instant) -> u64 {
        let number = self.next_span;
        self.next_span += 1;
        let span = Span {
            user,
            start: Mark::new(start),
            until: Mark::new(start),
            sure: Tally::default(),
            beyond: Tally::default(),
        };
        self.spans.insert(number, span);
        number
    }

    /// Says where an open span ends if nothing more happens. It never moves back.
    pub(super) fn until(&mut self, span: u64, at: Instant) {
        if let Some(span) = self.spans.get_mut(&span)
            && at > span.until.at
        {
            span.until = Mark::new(at);
            span.sure.append(std::mem::take(&mut span.beyond));
        }
    }

    /// Forgets a span.
    pub(super) fn drop_span(&mut self, span: u64) {
        self.spans.remove(&span);
    }

    /// Closes a span at `end` and tells what it used, by the samples there are.
    pub(super) fn close(&mut self, span: u64, end: Instant, meta: Meta<'_>) -> Option<Spent> {
        let Span {
            user,
            start,
            until,
            mut sure,
            beyond,
        } = self.spans.remove(&span)?;
        self.shares.settle(end, newest(&self.series));
        let known = |mark: Mark, edge| {
            mark.known.unwrap_or_else(|| {
                let sums = self.series.at(mark.at, edge);
                (sums, self.shares.at(user, mark.at, total(&sums)))
            })
        };
        let (from, joules_from) = known(start, Edge::Start);
        let ending = if until.at == end {
            until
        } else {
            Mark::new(end)
        };
        let (to, joules_to) = known(ending, Edge::End);
        if end > until.at {
            sure.append(beyond);
        }
        let node = self.energy_between((start.at, &from), (end, &to), &mut sure, meta);
        let covered = self.series.used(Domain::Total, &from, &to);
        let is_covered = covered.is_some_and(|covered| covered.covered_s > 0.0);
        let known = node.quality != EnergyQuality::Unavailable && is_covered;
        Some(Spent {
            joules: known.then_some(joules_to - joules_from),
            board: sure.conditions.state(),
            node,
        })
    }

    /// Energy of a span of the kept past.
    pub(super) fn energy(&self, start: Instant, end: Instant, meta: Meta<'_>) -> SpanEnergy {
        let (from, to) = (
            self.series.at(start, Edge::Start),
            self.series.at(end, Edge::End),
        );
        self.energy_between((start, &from), (end, &to), &mut Tally::default(), meta)
    }

    /// The board's state over a span of the kept past.
    pub(super) fn board(&self, start: Instant, end: Instant) -> Option<BoardState> {
        let mut sum = ConditionSum::default();
        self.conditions.add_to(&mut sum, start, end);
        sum.state()
    }

    fn energy_between(
        &self,
        (start, from): (Instant, &Sums),
        (end, to): (Instant, &Sums),
        tally: &mut Tally,
        Meta { source, quality }: Meta<'_>,
    ) -> SpanEnergy {
        self.conditions.add_to(&mut tally.conditions, start, end);
        let length = seconds_between(start, end);
        if length <= 0.0 {
            return SpanEnergy::unavailable(source);
        }
        for point in self.series.within(start, end) {
            tally.add(point);
        }
        for edge in [start, end] {
            for point in self.series.around(edge) {
                tally.add_rule(&point.total_from);
            }
        }
        let mut domains = Vec::new();
        let mut coverage = 0.0;
        let mut least = 1.0_f64;
        for domain in Domain::ALL {
            let Some(used) = self.series.used(domain, from, to) else {
                continue;
            };
            let share = (used.covered_s / length).clamp(0.0, 1.0);
            least = least.min(share);
            if domain == Domain::Total {
                coverage = share;
            }
            if used.covered_s > 0.0 {
                domains.push(DomainEnergy {
                    domain: domain.as_str().to_owned(),
                    joules: used.joules,
                    mean_watts: used.joules / used.covered_s,
                    peak_watts: tally.peaks.get(domain as usize).copied().flatten(),
                });
            }
        }
        let rules: Vec<&str> = tally.rules.iter().map(|rule| &**rule).collect();
        SpanEnergy {
            source: source.to_owned(),
            quality: if coverage <= 0.0 {
                EnergyQuality::Unavailable
            } else if quality == EnergyQuality::Measured && least < FULL_COVERAGE {
                EnergyQuality::Partial
            } else {
                quality
            },
            total_from: rules.join(", then "),
            samples: tally.samples,
            coverage,
            domains,
        }
    }

    /// When the newest sample was taken.
    pub(super) fn newest(&self) -> Option<Instant> {
        self.series.newest()
    }

    /// Power now by domain; empty without a fresh sample.
    pub(super) fn watts(&self, now: Instant) -> Vec<DomainWatts> {
        let Some(newest) = self.series.present(now) else {
            return Vec::new();
        };
        Domain::ALL
            .into_iter()
            .filter_map(|domain| {
                Some(DomainWatts {
                    domain: domain.as_str().to_owned(),
                    watts: newest.watts(domain)?,
                })
            })
            .collect()
    }

    /// Joules and covered seconds of each domain since sampling began, up to the newest sample.
    pub(super) fn since_start(&self) -> Vec<(Domain, f64, f64)> {
        let sums = self.series.sums();
        Domain::ALL
            .into_iter()
            .filter_map(|domain| {
                let used = self.series.used(domain, &Sums::default(), &sums)?;
                Some((domain, used.joules, used.covered_s))
            })
            .collect()
    }

    #[cfg(test)]
    pub(super) fn footprint(&self) -> usize {
        self.series.within_all() + self.shares.pieces() + self.conditions.len() + self.spans.len()
    }
}

/// The newest sample, and the node's joules up to it.
fn newest(series: &Series) -> (Instant, f64) {
    let at = series.newest().unwrap_or_else(Instant::now);
    (at, total(&series.sums()))
}

#[cfg(test)]
mod tests;
