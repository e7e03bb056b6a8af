//! What a run has counted.

use parking_lot::Mutex;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Upper ends of the delay classes grow by this factor: a percentile is told within 5 %.
const GROWTH: f64 = 1.05;
/// Upper end of the first class, milliseconds.
const FIRST_MS: f64 = 0.1;
/// Classes: the last ends beyond an hour.
const CLASSES: usize = 360;

/// Counts delays in classes that grow.
#[derive(Debug)]
pub(crate) struct Delays(Mutex<(Vec<u64>, u64, f64)>);

impl Default for Delays {
    fn default() -> Self {
        Self(Mutex::new((vec![0; CLASSES], 0, 0.0)))
    }
}

/// Middle, tail and largest of some delays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DelaySummary {
    /// How many.
    pub count: u64,
    /// Median, milliseconds.
    pub p50_ms: f64,
    /// 99th percentile, milliseconds.
    pub p99_ms: f64,
    /// Largest, milliseconds.
    pub largest_ms: f64,
}

impl Delays {
    pub(crate) fn add(&self, delay: Duration) {
        let ms = delay.as_secs_f64() * 1e3;
        let class = (ms / FIRST_MS).max(1.0).log(GROWTH).ceil() as usize;
        let mut inner = self.0.lock();
        inner.0[class.min(CLASSES - 1)] += 1;
        inner.1 += 1;
        inner.2 = inner.2.max(ms);
    }

    pub(crate) fn summary(&self) -> DelaySummary {
        let inner = self.0.lock();
        let (classes, count, largest_ms) = (&inner.0, inner.1, inner.2);
        let quantile = |q: f64| {
            let wanted = (q * count as f64).ceil() as u64;
            let mut seen = 0;
            for (class, n) in classes.iter().enumerate() {
                seen += n;
                if seen >= wanted && seen > 0 {
                    return (FIRST_MS * GROWTH.powi(class as i32)).min(largest_ms);
                }
            }
            0.0
        };
        DelaySummary {
            count,
            p50_ms: quantile(0.5),
            p99_ms: quantile(0.99),
            largest_ms,
        }
    }
}

/// How a desired value spread.
#[derive(Clone, Copy, Debug)]
struct Spread {
    first: Instant,
    last: Instant,
    taken: u64,
    refused: u64,
}

/// How a desired value spread among the nodes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SpreadSummary {
    /// Its revision.
    pub revision: u64,
    /// Nodes that took it.
    pub taken: u64,
    /// Nodes that refused it.
    pub refused: u64,
    /// From the first notice or answer that any node had of it to the last node's taking it, seconds.
    pub seconds: f64,
}

/// All counters of a run.
#[derive(Debug, Default)]
pub(crate) struct Totals {
    pub(crate) statuses: AtomicU64,
    pub(crate) pulls: AtomicU64,
    pub(crate) notices: AtomicU64,
    pub(crate) made: AtomicU64,
    pub(crate) batches: AtomicU64,
    pub(crate) bytes: AtomicU64,
    pub(crate) acknowledged: AtomicU64,
    pub(crate) busy: AtomicU64,
    pub(crate) refused: AtomicU64,
    pub(crate) no_reply: AtomicU64,
    pub(crate) answers: Delays,
    /// Those between the floods of the beginning and of the end.
    pub(crate) settled: Delays,
    revisions: Mutex<BTreeMap<u64, Spread>>,
}

pub(crate) fn count(counter: &AtomicU64, more: u64) {
    counter.fetch_add(more, Ordering::Relaxed);
}

pub(crate) fn read(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

impl Totals {
    /// A node has heard of a revision.
    pub(crate) fn heard_of(&self, revision: u64) {
        let now = Instant::now();
        self.revisions.lock().entry(revision).or_insert(Spread {
            first: now,
            last: now,
            taken: 0,
            refused: 0,
        });
    }

    /// A node has taken it or refused it.
    pub(crate) fn decided(&self, revision: u64, taken: bool) {
        self.heard_of(revision);
        if let Some(spread) = self.revisions.lock().get_mut(&revision) {
            spread.last = Instant::now();
            if taken {
                spread.taken += 1;
            } else {
                spread.refused += 1;
            }
        }
    }

    /// Every revision that nodes heard of.
    pub(crate) fn spreads(&self) -> Vec<SpreadSummary> {
        let summary = |(revision, spread): (&u64, &Spread)| SpreadSummary {
            revision: *revision,
            taken: spread.taken,
            refused: spread.refused,
            seconds: (spread.last - spread.first).as_secs_f64(),
        };
        self.revisions.lock().iter().map(summary).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_percentile_is_told_within_a_twentieth() {
        let delays = Delays::default();
        for ms in 1..=1_000 {
            delays.add(Duration::from_millis(ms));
        }
        let summary = delays.summary();
        assert_eq!((summary.count, summary.largest_ms), (1_000, 1_000.0));
        for (found, expected) in [(summary.p50_ms, 500.0), (summary.p99_ms, 990.0)] {
            assert!((found / expected - 1.0).abs() < 0.051, "{found} {expected}");
        }
        assert_eq!(Delays::default().summary(), DelaySummary::default());
    }
}
