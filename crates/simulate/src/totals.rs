//! Counts the messages of a run, and measures delays.

use parking_lot::Mutex;
use serde::Serialize;
use std::time::Duration;

/// Measured delays, microseconds.
#[derive(Debug, Default)]
pub(crate) struct Delays(Mutex<Vec<u32>>);

/// Median, 99th percentile and maximum of some delays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DelaySummary {
    /// The number of delays.
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
        // The nearest rank: the smallest delay that a share `q` of all does not exceed.
        let quantile = |q: f64| {
            let rank = (q * delays.len() as f64).ceil() as usize;
            let us = delays.get(rank.saturating_sub(1)).copied().unwrap_or(0);
            f64::from(us) / 1e3
        };
        DelaySummary {
            count: delays.len() as u64,
            p50_ms: quantile(0.5),
            p99_ms: quantile(0.99),
            largest_ms: quantile(1.0),
        }
    }
}

/// The counts of messages sent and answered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Reports made, including the backlog.
    pub made: u64,
    /// Reports acknowledged.
    pub acknowledged: u64,
    /// Status messages sent.
    pub statuses: u64,
    /// Batches sent, including resent ones.
    pub batches: u64,
    /// The bytes of all batches sent.
    pub batch_bytes: u64,
    /// Pulls sent.
    pub pulls: u64,
    /// Batches refused because the hub was busy.
    pub busy: u64,
    /// Batches refused by the hub for another reason.
    pub refused: u64,
    /// Batches without an answer.
    pub no_reply: u64,
}

/// All figures of a run.
#[derive(Debug, Default)]
pub(crate) struct Totals {
    pub(crate) counts: Mutex<Counts>,
    /// Delays of answers, without those of the start and of the end, when all nodes send at the same time, as only a
    /// simulation has it.
    pub(crate) answers: Delays,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_match_known_delays() {
        let delays = Delays::default();
        for ms in 1..=1_000 {
            delays.add(Duration::from_millis(ms));
        }
        let summary = delays.summary();
        assert_eq!(summary.count, 1_000);
        assert_eq!(summary.p50_ms, 500.0);
        assert_eq!(summary.p99_ms, 990.0);
        assert_eq!(summary.largest_ms, 1_000.0);
    }

    #[test]
    fn the_summary_of_no_delays_is_zeros() {
        assert_eq!(Delays::default().summary(), DelaySummary::default());
    }
}
