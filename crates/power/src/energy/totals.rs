//! Running totals of energy since sampling began, and their values at any recent instant.
//!
//! - Between two samples, power is interpolated linearly and a counter rises evenly.
//! - Power samples further apart than [`longest_gap`] are not joined: the time between adds no energy and is not
//!   covered. A counter keeps counting, so its samples are joined over up to [`LONGEST_COUNTED_S`].
//! - Nothing is assumed before the first sample or after the last.

use crate::reading::{Domain, PerDomain, Reading, Value, Values};
use std::borrow::Cow;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// The longest gap between a counter's samples that is trusted, seconds: a small counter may wrap after that.
const LONGEST_COUNTED_S: f64 = 60.0;

/// Samples kept for looking back: 100 s at the default interval.
const KEPT: usize = 1024;

/// The longest gap between two power samples that is bridged: a sample may fail or be late.
pub(crate) fn longest_gap(interval: Duration) -> Duration {
    interval.mul_f64(2.5).max(Duration::from_secs(1))
}

/// Joules, and the seconds that go with them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sum {
    /// Energy of the node, or a camera's share of it.
    pub joules: f64,
    /// Time that samples cover; for a camera, detector time that its avoided calls would have taken.
    pub seconds: f64,
}

/// All totals since sampling began.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Totals {
    /// The node's sums, by domain.
    pub sums: PerDomain<Sum>,
    /// The number of samples of the total.
    pub samples: u64,
    /// The cameras' totals, by number.
    pub cameras: Vec<(u64, Sum)>,
}

impl Totals {
    /// The node's total.
    pub(crate) const fn total(&self) -> Sum {
        self.sums.total
    }

    /// The totals of one camera.
    pub(crate) fn camera(&self, number: u64) -> Sum {
        self.cameras
            .iter()
            .find(|(camera, _)| *camera == number)
            .map(|(_, totals)| *totals)
            .unwrap_or_default()
    }
}

/// One sample, and the totals up to it.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    pub at: Instant,
    /// The origin of the total.
    pub total_from: Cow<'static, str>,
    /// Power by domain; for a counter, the mean since the previous sample.
    pub watts: PerDomain<Option<f64>>,
    values: Values,
    totals: Totals,
}

/// Sums samples, and keeps the newest.
#[derive(Debug)]
pub(crate) struct History {
    gap_s: f64,
    /// The totals up to the newest sample.
    pub totals: Totals,
    /// The time from the first sample to the newest, seconds.
    pub sampled_s: f64,
    /// The newest value of each domain.
    last: PerDomain<Option<(Instant, Value)>>,
    recent: VecDeque<Sample>,
}

impl History {
    /// Creates an empty history for samples taken every `interval`.
    pub(crate) fn new(interval: Duration) -> Self {
        Self {
            gap_s: longest_gap(interval).as_secs_f64(),
            totals: Totals::default(),
            sampled_s: 0.0,
            last: PerDomain::default(),
            recent: VecDeque::new(),
        }
    }

    /// Adds a sample. `divide` takes the joules of the total and the seconds since the previous sample and returns the
    /// cameras' totals. Returns false for a sample that is not later than the last: times always increase.
    pub(crate) fn add(
        &mut self,
        at: Instant,
        reading: &Reading,
        divide: impl FnOnce(f64, f64) -> Vec<(u64, Sum)>,
    ) -> bool {
        let newest = self.newest();
        if newest.is_some_and(|newest| newest >= at) {
            return false;
        }
        let joules_before = self.totals.total().joules;
        let watts = PerDomain::each(|domain| self.advance(domain, at, reading.value(domain)?));
        if reading.value(Domain::Total).is_some() {
            self.totals.samples += 1;
        }
        let seconds = newest.map_or(0.0, |newest| (at - newest).as_secs_f64());
        self.sampled_s += seconds;
        self.totals.cameras = divide(self.totals.total().joules - joules_before, seconds);
        if self.recent.len() == KEPT {
            self.recent.pop_front();
        }
        self.recent.push_back(Sample {
            at,
            total_from: reading.total_from.clone(),
            watts,
            values: reading.values,
            totals: self.totals.clone(),
        });
        true
    }

    /// Adds a value to one domain and returns its power.
    fn advance(&mut self, domain: Domain, at: Instant, value: Value) -> Option<f64> {
        let Some((last_at, last_value)) = self.last[domain].replace((at, value)) else {
            return value.mean_watts(None, 0.0);
        };
        let seconds = (at - last_at).as_secs_f64();
        let (joules, longest_s) = match (last_value, value) {
            (Value::Power(old), Value::Power(new)) => (0.5 * (old + new) * seconds, self.gap_s),
            (Value::Counter(old), Value::Counter(new)) => {
                (new - old, self.gap_s.max(LONGEST_COUNTED_S))
            }
            // A source that changes from the one to the other leaves a gap.
            _ => (0.0, 0.0),
        };
        if seconds <= longest_s {
            let sum = &mut self.totals.sums[domain];
            sum.joules += joules;
            sum.seconds += seconds;
        }
        value.mean_watts(Some(last_value), seconds)
    }

    /// True if the source has ever read `domain`.
    pub(crate) fn has(&self, domain: Domain) -> bool {
        self.last[domain].is_some()
    }

    /// The newest sample.
    pub(crate) fn latest(&self) -> Option<&Sample> {
        self.recent.back()
    }

    /// The time of the newest sample.
    pub(crate) fn newest(&self) -> Option<Instant> {
        self.latest().map(|sample| sample.at)
    }

    /// The newest sample, unless it is too old to be current at `now`.
    pub(crate) fn present(&self, now: Instant) -> Option<&Sample> {
        let newest = self.latest()?;
        let age_s = now.saturating_duration_since(newest.at).as_secs_f64();
        if age_s > self.gap_s {
            return None;
        }
        Some(newest)
    }

    /// The last kept sample at or before `moment`.
    pub(crate) fn before(&self, moment: Instant) -> Option<&Sample> {
        let next = self.recent.partition_point(|sample| sample.at <= moment);
        self.recent.get(next.checked_sub(1)?)
    }

    /// The kept samples after `start`.
    pub(crate) fn after(&self, start: Instant) -> impl Iterator<Item = &Sample> {
        let first = self.recent.partition_point(|sample| sample.at <= start);
        self.recent.range(first..)
    }

    /// The totals at `moment`, or at the nearest kept sample if `moment` is before the first or after the last.
    pub(crate) fn at(&self, moment: Instant) -> Totals {
        match (self.before(moment), self.after(moment).next()) {
            (Some(before), Some(after)) => between(before, after, moment),
            (Some(sample), None) | (None, Some(sample)) => sample.totals.clone(),
            (None, None) => Totals::default(),
        }
    }
}

/// The totals at a moment between two samples.
fn between(before: &Sample, after: &Sample, moment: Instant) -> Totals {
    let whole = (after.at - before.at).as_secs_f64();
    let part = (moment - before.at).as_secs_f64() / whole;
    let mix = |old: Sum, new: Sum, energy_part: f64| Sum {
        joules: old.joules + energy_part * (new.joules - old.joules),
        seconds: old.seconds + part * (new.seconds - old.seconds),
    };
    // Where power rises, less than its part of the energy comes in the first part of the time.
    let energy_part = |domain: Domain| match (before.values[domain], after.values[domain]) {
        (Some(Value::Power(old)), Some(Value::Power(new))) if old + new > 0.0 => {
            part * (2.0 * old + (new - old) * part) / (old + new)
        }
        _ => part,
    };
    let totals_before = &before.totals;
    let totals_after = &after.totals;
    // Cameras divide the energy of the whole, whichever domain used it.
    let of_total = energy_part(Domain::Total);
    let cameras = totals_after.cameras.iter().map(|(number, sum_after)| {
        let sum_before = totals_before.camera(*number);
        (*number, mix(sum_before, *sum_after, of_total))
    });
    Totals {
        sums: PerDomain::each(|domain| {
            mix(
                totals_before.sums[domain],
                totals_after.sums[domain],
                energy_part(domain),
            )
        }),
        samples: totals_before.samples,
        cameras: cameras.collect(),
    }
}

#[cfg(test)]
impl History {
    pub(crate) fn len(&self) -> usize {
        self.recent.len()
    }
}

#[cfg(test)]
mod tests;
