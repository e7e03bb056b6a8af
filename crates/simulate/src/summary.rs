//! What a run came to, as a table and as JSON.

use super::cost::ProcessCost;
use super::totals::{DelaySummary, SpreadSummary};
use serde::Serialize;
use std::fmt::{self, Write};

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
    /// Notifier heard.
    pub notices: u64,
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
    /// How desired values spread.
    pub spreads: Vec<SpreadSummary>,
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
        let per_s = |count: u64| count as f64 / self.played_s.max(1e-9);
        writeln!(
            f,
            "{} nodes, {} sessions (open after {:.1} s), {:.0} s",
            self.nodes, self.sessions, self.opened_s, self.played_s
        )?;
        writeln!(
            f,
            "status           {:>10}  {:>9.1}/s",
            self.statuses,
            per_s(self.statuses)
        )?;
        writeln!(f, "reports made     {:>10}", self.made)?;
        writeln!(
            f,
            "  acknowledged   {:>10}  the last {:.1} s after the end",
            self.acknowledged, self.drained_s
        )?;
        let bytes = self.batch_bytes as f64 / self.batches.max(1) as f64;
        writeln!(
            f,
            "batches sent     {:>10}  {bytes:.0} B each",
            self.batches
        )?;
        writeln!(
            f,
            "  busy, refused  {:>10}  {} refused, {} unanswered",
            self.busy, self.refused, self.no_reply
        )?;
        let a = &self.answers;
        writeln!(
            f,
            "acknowledgement  p50 {:.0} ms, p99 {:.0} ms, largest {:.0} ms",
            a.p50_ms, a.p99_ms, a.largest_ms
        )?;
        let s = &self.settled;
        if s.count > 0 {
            writeln!(
                f,
                "  from {:.0} s on      p50 {:.0} ms, p99 {:.0} ms, largest {:.0} ms, of {} until the end",
                crate::session::SETTLED.as_secs_f64(),
                s.p50_ms,
                s.p99_ms,
                s.largest_ms,
                s.count
            )?;
        }
        for spread in &self.spreads {
            writeln!(
                f,
                "revision {:<5} taken by {} nodes, refused by {}, within {:.2} s of the first",
                spread.revision, spread.taken, spread.refused, spread.seconds
            )?;
        }
        let mut table = format!(
            "{:<16} {:>10} {:>12} {:>12}\n",
            "process", "of a core", "memory", "largest"
        );
        for cost in &self.costs {
            let percent = cost
                .cores
                .map_or_else(|| "-".to_owned(), |c| format!("{:.1} %", c * 100.0));
            let megabytes = |bytes: Option<u64>| {
                bytes.map_or_else(|| "-".to_owned(), |b| format!("{:.0} MB", b as f64 / 1e6))
            };
            let (now, largest) = (megabytes(cost.resident), megabytes(cost.largest));
            writeln!(
                table,
                "{:<16} {percent:>10} {now:>12} {largest:>12}",
                cost.name
            )?;
        }
        f.write_str(&table)
    }
}
