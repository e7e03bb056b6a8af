//! Summarises a run, as a table and as JSON.

use super::totals::{Counts, DelaySummary};
use serde::Serialize;
use std::fmt;

/// The results of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The number of nodes.
    pub nodes: usize,
    /// The number of sessions they shared.
    pub sessions: usize,
    /// Seconds until all sessions were open.
    pub opened_s: f64,
    /// Seconds simulated from then on.
    pub played_s: f64,
    /// Seconds at the end until everything was acknowledged or given up.
    pub drained_s: f64,
    /// The counts of messages sent and answered.
    #[serde(flatten)]
    pub counts: Counts,
    /// The delay from sending a batch to its acknowledgement, without two floods that only the simulation has: all
    /// nodes start at the same time, and all send their remaining reports at the same time at the end.
    pub answers: DelaySummary,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = &self.counts;
        writeln!(
            f,
            "nodes: {}, sessions: {} (open after {:.1} s), {:.0} s",
            self.nodes, self.sessions, self.opened_s, self.played_s
        )?;
        writeln!(f, "status           {:>10}", counts.statuses)?;
        writeln!(f, "reports made     {:>10}", counts.made)?;
        writeln!(
            f,
            "  acknowledged   {:>10}  the last {:.1} s after the end",
            counts.acknowledged, self.drained_s
        )?;
        writeln!(
            f,
            "batches sent     {:>10}  {} B each; {} busy, {} refused, {} unanswered",
            counts.batches,
            counts.batch_bytes / counts.batches.max(1),
            counts.busy,
            counts.refused,
            counts.no_reply
        )?;
        let answers = &self.answers;
        writeln!(
            f,
            "acknowledgement  p50 {:.0} ms, p99 {:.0} ms, largest {:.0} ms, of {} between start and end",
            answers.p50_ms, answers.p99_ms, answers.largest_ms, answers.count
        )
    }
}
