//! The summary of a run, as a table and as JSON.

use super::cost::ProcessCost;
use super::totals::DelaySummary;
use serde::Serialize;
use std::fmt;

/// What a run came to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Nodes.
    pub nodes: usize,
    /// Sessions they shared.
    pub sessions: usize,
    /// Seconds until all sessions were open.
    pub opened_s: f64,
    /// Seconds played from then on.
    pub played_s: f64,
    /// Seconds that the end took until everything was acknowledged, or it was given up.
    pub drained_s: f64,
    /// Reports made, those of the backlog included.
    pub made: u64,
    /// Reports acknowledged.
    pub acknowledged: u64,
    /// Status messages sent.
    pub statuses: u64,
    /// Batches sent, those sent again included.
    pub batches: u64,
    /// Their bytes.
    pub batch_bytes: u64,
    /// Pulls sent.
    pub pulls: u64,
    /// Batches that the hub was too busy for.
    pub busy: u64,
    /// Batches that the hub refused for another reason.
    pub refused: u64,
    /// Batches that nobody answered.
    pub no_reply: u64,
    /// Delay from sending a batch to its acknowledgement.
    pub answers: DelaySummary,
    /// The same without two floods that only this program makes: all nodes begin at once, and send what they have at once
    /// at the end.
    pub settled: DelaySummary,
    /// What processes cost while the load ran.
    pub costs: Vec<ProcessCost>,
}

impl Summary {
    /// Whether every report made was acknowledged.
    pub const fn is_drained(&self) -> bool {
        self.made == self.acknowledged
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            nodes,
            sessions,
            opened_s,
            played_s,
            drained_s,
            ..
        } = self;
        let bytes = self.batch_bytes / self.batches.max(1);
        let (busy, refused, no_reply) = (self.busy, self.refused, self.no_reply);
        writeln!(
            f,
            "{nodes} nodes, {sessions} sessions (open after {opened_s:.1} s), {played_s:.0} s\n\
             status           {:>10}\n\
             reports made     {:>10}\n  \
             acknowledged   {:>10}  the last {drained_s:.1} s after the end\n\
             batches sent     {:>10}  {bytes} B each; {busy} busy, {refused} refused, {no_reply} unanswered",
            self.statuses, self.made, self.acknowledged, self.batches
        )?;
        let settled = crate::session::SETTLED.as_secs();
        for (from, of) in [(0, &self.answers), (settled, &self.settled)] {
            writeln!(
                f,
                "acknowledgement  p50 {:.0} ms, p99 {:.0} ms, largest {:.0} ms, of {} from {from} s on",
                of.p50_ms, of.p99_ms, of.largest_ms, of.count
            )?;
        }
        for cost in &self.costs {
            writeln!(f, "{cost}")?;
        }
        Ok(())
    }
}
