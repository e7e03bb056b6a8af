//! A meter's samples, summed up as they come: energy and covered time since sampling began, at any moment of
//! the kept past. The energy of a span is the difference of its two ends, so its length costs no memory.
//!
//! - Between two samples power is a straight line and a counter rises evenly.
//! - A gap longer than [`Series::gap`] is not bridged: its time is not covered and adds no energy. A counter,
//!   though, counts on while nobody looks: a gap of up to [`LONGEST_COUNTED_S`] that lies wholly inside a span
//!   is exact, and covered. An end of a span that falls into a gap is moved to the gap's inner edge.
//! - Where a span reaches beyond the first or the last sample by at most a gap, the power at that edge is taken
//!   to hold.

use super::reading::{Domain, Reading, Value, Values};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Longest gap of a counter's samples that is believed, seconds: a small counter may have wrapped after that.
pub(super) const LONGEST_COUNTED_S: f64 = 60.0;

/// How long samples are kept at least: long enough for a clip whose end is noticed late.
const KEEP_AT_LEAST: Duration = Duration::from_secs(60);

/// Power and counter of each domain.
const PARTS: usize = 2 * Domain::ALL.len();

/// Energy and the time it was seen to be used in, since sampling began.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Sum {
    /// Joules.
    pub joules: f64,
    /// Seconds.
    pub covered_s: f64,
}

/// The sums of all parts at one moment.
pub(super) type Sums = [Sum; PARTS];

/// The longest gap between two samples that is bridged: a sample may fail, or come late, but no more.
pub(super) fn longest_gap(interval: Duration) -> Duration {
    interval.mul_f64(2.5).max(Duration::from_secs(1))
}

/// Which end of a span a moment is: it matters inside a gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Edge {
    Start,
    End,
}

/// Something a domain tells: its power, or its counter.
#[derive(Clone, Copy, Debug)]
struct Part(usize);

impl Part {
    fn all() -> impl Iterator<Item = Self> {
        (0..PARTS).map(Self)
    }

    fn of(domain: Domain) -> [Self; 2] {
        let first = 2 * (domain as usize);
        [Self(first), Self(first + 1)]
    }

    const fn is_counter(self) -> bool {
        self.0 % 2 == 1
    }

    fn value(self, values: &Values) -> Option<f64> {
        let domain = Domain::ALL.get(self.0 / 2)?;
        let Value { watts, joules } = values.get(*domain);
        if self.is_counter() { joules } else { watts }
    }

    fn sum(self, sums: &Sums) -> Sum {
        sums.get(self.0).copied().unwrap_or_default()
    }
}

/// One sample and the sums up to it.
#[derive(Clone, Debug)]
pub(super) struct Point {
    /// When.
    pub at: Instant,
    /// How the total came about.
    pub total_from: Arc<str>,
    values: Values,
    sums: Sums,
    /// Power by domain; of a counter, the mean since the regular sample before. None of an extra sample.
    watts: [Option<f64>; Domain::ALL.len()],
    regular: bool,
}

impl Point {
    /// Power of a domain, if it is known and the sample is a regular one.
    pub(super) fn watts(&self, domain: Domain) -> Option<f64> {
        self.watts.get(domain as usize).copied().flatten()
    }

    /// Whether it is a regular sample of the total.
    pub(super) fn is_of_the_total(&self) -> bool {
        self.regular && self.values.get(Domain::Total) != Value::default()
    }
}

/// The samples of the last while, oldest first, each with the sums up to it.
#[derive(Debug)]
pub(super) struct Series {
    gap: f64,
    keep: Duration,
    points: VecDeque<Point>,
    sums: Sums,
    /// The first sample ever and the newest of each part.
    first: [Option<Instant>; PARTS],
    last: [Option<(Instant, f64)>; PARTS],
    /// The newest regular sample.
    last_regular: Option<(Instant, Values)>,
}

impl Series {
    /// Of samples taken every `interval`.
    pub(super) fn new(interval: Duration) -> Self {
        let gap = longest_gap(interval);
        Self {
            gap: gap.as_secs_f64(),
            keep: KEEP_AT_LEAST.max(4 * gap),
            points: VecDeque::new(),
            sums: Sums::default(),
            first: [None; PARTS],
            last: [None; PARTS],
            last_regular: None,
        }
    }

    /// Adds a sample; one that is not later than the last is dropped, so that times always rise. `regular` says
    /// that it came at its interval, and not in between because somebody asked.
    pub(super) fn push(&mut self, at: Instant, reading: &Reading, regular: bool) {
        if self.newest().is_some_and(|last| last >= at) {
            return;
        }
        for part in Part::all() {
            if let Some(value) = part.value(&reading.values) {
                self.advance(part, at, value);
            }
        }
        let watts = if regular {
            let before = self.last_regular.replace((at, reading.values));
            Domain::ALL.map(|domain| self.watts_of(domain, at, &reading.values, before.as_ref()))
        } else {
            Default::default()
        };
        self.points.push_back(Point {
            at,
            total_from: Arc::clone(&reading.total_from),
            values: reading.values,
            sums: self.sums,
            watts,
            regular,
        });
    }

    fn advance(&mut self, part: Part, at: Instant, value: f64) {
        let (Some(sum), Some(last), Some(first)) = (
            self.sums.get_mut(part.0),
            self.last.get_mut(part.0),
            self.first.get_mut(part.0),
        ) else {
            return;
        };
        first.get_or_insert(at);
        let Some((then, before)) = last.replace((at, value)) else {
            return;
        };
        let seconds = (at - then).as_secs_f64();
        let joules = if part.is_counter() {
            (seconds <= self.gap.max(LONGEST_COUNTED_S)).then_some(value - before)
        } else {
            (seconds <= self.gap).then_some(0.5 * (value + before) * seconds)
        };
        if let Some(joules) = joules {
            sum.joules += joules;
            sum.covered_s += seconds;
        }
    }

    /// Power of a sample: what it reads, plus the mean rise of the counter since the regular sample before. A
    /// part that was there once and is missing makes it unknown.
    fn watts_of(
        &self,
        domain: Domain,
        at: Instant,
        values: &Values,
        before: Option<&(Instant, Values)>,
    ) -> Option<f64> {
        let value = values.get(domain);
        let counted = value.joules.and_then(|joules| {
            let (then, earlier) = before?;
            let seconds = (at - *then).as_secs_f64();
            Some((joules - earlier.get(domain).joules?) / seconds)
        });
        let [watts, joules] = Part::of(domain);
        let has = |part: Part| self.first.get(part.0).is_some_and(Option::is_some);
        match (value.watts, counted) {
            (Some(watts), Some(counted)) => Some(watts + counted),
            (Some(watts), None) if !has(joules) => Some(watts),
            (None, Some(counted)) if !has(watts) => Some(counted),
            _ => None,
        }
    }

    /// When the newest sample was taken.
    pub(super) fn newest(&self) -> Option<Instant> {
        self.points.back().map(|point| point.at)
    }

    /// The newest regular sample, unless it is too old to speak of `now`.
    pub(super) fn present(&self, now: Instant) -> Option<&Point> {
        let newest = self.points.iter().rev().find(|point| point.regular)?;
        (seconds_between(newest.at, now) <= self.gap).then_some(newest)
    }

    /// The sums up to the newest sample.
    pub(super) fn sums(&self) -> Sums {
        self.sums
    }

    /// The oldest moment before which nothing will be known once [`forget`](Self::forget) was called; `None`
    /// while nothing has to go.
    pub(super) fn leaving(&self) -> Option<Instant> {
        let (second, newest) = (self.points.get(1)?, self.points.back()?);
        (newest.at.duration_since(second.at) > self.keep).then_some(second.at)
    }

    /// Forgets the oldest sample.
    pub(super) fn forget(&mut self) -> Option<Point> {
        self.points.pop_front()
    }

    /// The kept samples in `[start, end]`.
    pub(super) fn within(&self, start: Instant, end: Instant) -> impl Iterator<Item = &Point> {
        let first = self.points.partition_point(|point| point.at < start);
        let last = self.points.partition_point(|point| point.at <= end);
        self.points.range(first.min(last)..last)
    }

    /// The samples before and after `moment`, as far as they are kept.
    pub(super) fn around(&self, moment: Instant) -> impl Iterator<Item = &Point> {
        let after = self.points.partition_point(|point| point.at < moment);
        let last = (after + 1).min(self.points.len());
        self.points.range(after.saturating_sub(1)..last)
    }

    /// The sums at any kept moment.
    pub(super) fn at(&self, moment: Instant, edge: Edge) -> Sums {
        let mut sums = Sums::default();
        for (part, sum) in Part::all().zip(&mut sums) {
            *sum = self.part_at(part, moment, edge);
        }
        sums
    }

    fn part_at(&self, part: Part, moment: Instant, edge: Edge) -> Sum {
        let here = self.points.partition_point(|point| point.at <= moment);
        let told = |point: &&Point| part.value(&point.values).is_some();
        let before = self.points.range(..here).rev().find(told);
        let after = self.points.range(here..).find(told);
        let carried = || {
            let known = self.points.get(here.saturating_sub(1));
            known.map_or_else(Sum::default, |point| part.sum(&point.sums))
        };
        match (before, after) {
            (Some(before), Some(after)) => {
                if seconds_between(before.at, after.at) <= self.gap {
                    between(part, before, after, seconds_between(before.at, moment))
                } else if edge == Edge::Start && moment > before.at {
                    part.sum(&after.sums)
                } else {
                    part.sum(&before.sums)
                }
            }
            (Some(before), None) => {
                let beyond = seconds_between(before.at, moment);
                match self.rate_before(part, before) {
                    Some(rate) if beyond <= self.gap => moved(part.sum(&before.sums), rate, beyond),
                    _ => part.sum(&before.sums),
                }
            }
            (None, Some(after)) => {
                let ahead = seconds_between(moment, after.at);
                let is_first = self.first.get(part.0) == Some(&Some(after.at));
                match self.rate_after(part, after) {
                    Some(rate) if is_first && ahead <= self.gap => {
                        moved(part.sum(&after.sums), rate, -ahead)
                    }
                    _ if edge == Edge::Start && here > 0 => part.sum(&after.sums),
                    _ => carried(),
                }
            }
            (None, None) => carried(),
        }
    }

    /// Power of `part` at its newest sample, if it was known without a gap.
    fn rate_before(&self, part: Part, newest: &Point) -> Option<f64> {
        let value = part.value(&newest.values)?;
        if !part.is_counter() {
            return Some(value);
        }
        let earlier = self.points.iter().rev().find(|point| {
            point.at < newest.at && point.regular && part.value(&point.values).is_some()
        })?;
        let seconds = seconds_between(earlier.at, newest.at);
        (seconds <= self.gap)
            .then(|| Some((value - part.value(&earlier.values)?) / seconds))
            .flatten()
    }

    /// Power of `part` at its first sample.
    fn rate_after(&self, part: Part, first: &Point) -> Option<f64> {
        let value = part.value(&first.values)?;
        if !part.is_counter() {
            return Some(value);
        }
        let later = self.points.iter().find(|point| {
            point.at > first.at && point.regular && part.value(&point.values).is_some()
        })?;
        let seconds = seconds_between(first.at, later.at);
        (seconds <= self.gap)
            .then(|| Some((part.value(&later.values)? - value) / seconds))
            .flatten()
    }

    /// What a span used of a domain, from the sums at its two ends: joules, and seconds that are covered.
    /// `None` for a domain that was never told.
    pub(super) fn used(&self, domain: Domain, start: &Sums, end: &Sums) -> Option<Sum> {
        let mut used: Option<Sum> = None;
        for part in Part::of(domain) {
            if self.first.get(part.0).is_none_or(Option::is_none) {
                continue;
            }
            let (from, to) = (part.sum(start), part.sum(end));
            let covered_s = to.covered_s - from.covered_s;
            let part = if covered_s > 0.0 {
                Sum {
                    joules: to.joules - from.joules,
                    covered_s,
                }
            } else {
                Sum::default()
            };
            // Where a domain is the sum of two, both have to be known.
            used = Some(used.map_or(part, |other| Sum {
                joules: other.joules + part.joules,
                covered_s: other.covered_s.min(part.covered_s),
            }));
        }
        used
    }
}

/// The joules of the total domain in `sums`.
pub(super) fn total(sums: &Sums) -> f64 {
    Part::of(Domain::Total)
        .into_iter()
        .map(|part| part.sum(sums).joules)
        .sum()
}

/// The sum `seconds` after `before`, on the way to `after`.
fn between(part: Part, before: &Point, after: &Point, seconds: f64) -> Sum {
    let sum = part.sum(&before.sums);
    let whole = seconds_between(before.at, after.at);
    let (Some(from), Some(to)) = (part.value(&before.values), part.value(&after.values)) else {
        return sum;
    };
    let rate = if part.is_counter() {
        (to - from) / whole
    } else {
        from + 0.5 * (to - from) * seconds / whole
    };
    moved(sum, rate, seconds)
}

fn moved(sum: Sum, watts: f64, seconds: f64) -> Sum {
    Sum {
        joules: sum.joules + watts * seconds,
        covered_s: sum.covered_s + seconds,
    }
}

/// Seconds from one moment to another; negative if that is earlier.
pub(super) fn seconds_between(from: Instant, to: Instant) -> f64 {
    if to >= from {
        (to - from).as_secs_f64()
    } else {
        -(from - to).as_secs_f64()
    }
}

#[cfg(test)]
mod tests;
