//! The counts of a run.

use parking_lot::Mutex;
use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Delays as they were measured, microseconds.
#[derive(Debug, Default)]
pub(crate) struct Delays(Mutex<Vec<u32>>);

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
        let us = u32::try_from(delay.as_micros()).unwrap_or(u32::MAX);
        self.0.lock().push(us);
    }

    pub(crate) fn summary(&self) -> DelaySummary {
        let mut delays = self.0.lock().clone();
        delays.sort_unstable();
        let quantile = |q: f64| {
            let at = (q * delays.len() as f64).ceil() as usize;
            let us = delays.get(at.saturating_sub(1)).copied();
            f64::from(us.unwrap_or(0)) / 1e3
        };
        DelaySummary {
            count: delays.len() as u64,
            p50_ms: quantile(0.5),
            p99_ms: quantile(0.99),
            largest_ms: quantile(1.0),
        }
    }
}

/// All counters of a run.
#[derive(Debug, Default)]
pub(crate) struct Totals {
    pub(crate) statuses: AtomicU64,
    pub(crate) pulls: AtomicU64,
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
}

pub(crate) fn count(counter: &AtomicU64, more: u64) {
    counter.fetch_add(more, Ordering::Relaxed);
}

pub(crate) fn read(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_delays() {
        let delays = Delays::default();
        for ms in 1..=1_000 {
            delays.add(Duration::from_millis(ms));
        }
        let summary = delays.summary();
        assert_eq!((summary.count, summary.largest_ms), (1_000, 1_000.0));
        assert_eq!((summary.p50_ms, summary.p99_ms), (500.0, 990.0));
        assert_eq!(Delays::default().summary(), DelaySummary::default());
    }
}
