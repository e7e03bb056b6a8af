//! Gates: what a change may cost at most, and whether it did, judged on the same nodes before and after.
//!
//! A gate bounds the change of a metric: `joules<=+5%` (relative), `skip_rate>=-0.05` (absolute). The change is the mean over
//! nodes of each node's own difference, with a confidence interval. The whole interval within the bound: passed.
//! The whole interval beyond it: failed. Otherwise undecided: more has to be measured.

use super::metric::{BeforeAfter, Figure, Metric};
use super::statistics::{Component, Interval, Moments, change, mean_of_components};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use utoipa::ToSchema;

/// From so many nodes on, the interval speaks about nodes of this kind (paired t over nodes); with fewer, about
/// these nodes only (variance of their clips), for with two or three pairs an interval over nodes says nothing.
pub const PAIRED_FROM: usize = 5;

/// The most that a change may cost in one metric.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Gate {
    /// What is bounded.
    pub metric: Metric,
    /// The bound on the change: a share of the value before when relative, else in the metric's unit.
    pub bound: f64,
    /// Whether the change is taken relative to the value before.
    pub relative: bool,
    /// Whether the gate holds only where the metric is measured: without, a metric that nobody reports leaves the
    /// gate undecided.
    pub where_measured: bool,
}

/// Why a text is no gate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no gate: {reason}; write for example `joules<=+5%` or `skip_rate>=-0.05`")]
pub struct GateError {
    text: String,
    reason: String,
}

impl Gate {
    /// The gates of a rollout that names none: the skip rate may fall by 0.05, a clip may cost 5 % more energy, the latency's 99th
    /// percentile may rise by 10 %, the shares of degraded frames and detector errors by 0.01 each.
    pub fn defaults() -> Vec<Self> {
        let gate = |metric, bound, relative, where_measured| Self {
            metric,
            bound,
            relative,
            where_measured,
        };
        vec![
            gate(Metric::SkipRate, -0.05, false, false),
            gate(Metric::Joules, 0.05, true, true),
            gate(Metric::LatencyP99, 0.10, true, false),
            gate(Metric::Degraded, 0.01, false, false),
            gate(Metric::DetectorErrors, 0.01, false, true),
        ]
    }
}

impl FromStr for Gate {
    type Err = GateError;

    fn from_str(text: &str) -> Result<Self, GateError> {
        let fault = |reason: String| GateError {
            text: text.to_owned(),
            reason,
        };
        let (rest, where_measured) = match text.trim().strip_suffix('?') {
            Some(rest) => (rest.trim_end(), true),
            None => (text.trim(), false),
        };
        let (name, most, bound) = if let Some((name, bound)) = rest.split_once("<=") {
            (name, true, bound)
        } else if let Some((name, bound)) = rest.split_once(">=") {
            (name, false, bound)
        } else {
            return Err(fault("it has neither `<=` nor `>=`".to_owned()));
        };
        let metric = Metric::by_name(name.trim()).ok_or_else(|| {
            let names: Vec<_> = Metric::ALL.iter().map(|metric| metric.name()).collect();
            fault(format!("the metrics are {}", names.join(", ")))
        })?;
        if metric.more_is_worse() != most {
            let sign = if most { ">=" } else { "<=" };
            return Err(fault(format!("`{metric}` is bounded by `{sign}`")));
        }
        let bound = bound.trim();
        let (number, relative) = match bound.strip_suffix('%') {
            Some(percent) => (percent.trim(), true),
            None => (bound, false),
        };
        let number: f64 = number
            .parse()
            .ok()
            .filter(|number: &f64| number.is_finite())
            .ok_or_else(|| fault(format!("`{bound}` is no number")))?;
        let bound = if relative { number / 100.0 } else { number };
        Ok(Self {
            metric,
            bound,
            relative,
            where_measured,
        })
    }
}

impl fmt::Display for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.metric.more_is_worse() {
            "<="
        } else {
            ">="
        };
        write!(f, "{}{sign}", self.metric)?;
        if self.relative {
            // As written, without the noise of a division by a hundred.
            write!(f, "{:+}%", (self.bound * 1e10).round() / 1e8)?;
        } else {
            write!(f, "{:+}", self.bound)?;
        }
        f.write_str(if self.where_measured { "?" } else { "" })
    }
}

impl TryFrom<String> for Gate {
    type Error = GateError;

    fn try_from(text: String) -> Result<Self, GateError> {
        text.parse()
    }
}

impl From<Gate> for String {
    fn from(gate: Gate) -> Self {
        gate.to_string()
    }
}

/// What a gate or a stage came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The change is within the bound.
    Passed,
    /// The change is beyond the bound.
    Failed,
    /// What was measured leaves both possible.
    Undecided,
}

/// What the interval is taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// Paired differences of nodes.
    Nodes,
    /// The clips of few nodes: it speaks of these nodes.
    Clips,
}

/// A gate's verdict on one figure, with its numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GateResult {
    /// The gate, as written.
    #[schema(value_type = String)]
    pub gate: Gate,
    /// The figure; absent when none of the metric was measured.
    pub figure: Option<Figure>,
    /// Nodes with enough clips before and after.
    pub nodes: usize,
    /// Nodes with too few.
    pub nodes_left_out: usize,
    /// Clips before, of those nodes.
    pub clips_before: u64,
    /// Clips after, of those nodes.
    pub clips_after: u64,
    /// Mean over those nodes before; absent without any.
    pub before: Option<f64>,
    /// Mean over those nodes after; absent without any.
    pub after: Option<f64>,
    /// Mean change with its interval: a share of the value before when the gate is relative.
    pub change: Option<Interval>,
    /// What the interval is taken over.
    pub basis: Option<Basis>,
    /// The verdict.
    pub verdict: Verdict,
}

/// How sure a verdict must be, and on how much.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Level of the two-sided interval: at 0.9 each side is wrong one time in twenty.
    pub level: f64,
    /// Fewest clips of a node on either side; at least 2.
    pub fewest_clips: u64,
}

/// Judges every gate on every figure it has.
pub fn judge(gates: &[Gate], nodes: &[BeforeAfter], evidence: Evidence) -> Vec<GateResult> {
    let mut results = Vec::new();
    for gate in gates {
        let seen = |figure: &Figure| {
            let has = |side: &super::metric::Figures| side.get(figure).is_some_and(|m| m.count > 0);
            nodes
                .iter()
                .any(|node| has(&node.before) || has(&node.after))
        };
        let figures: Vec<_> = (gate.metric.figures().iter().copied())
            .filter(seen)
            .collect();
        results.extend(
            figures
                .iter()
                .map(|figure| judge_one(gate, *figure, nodes, evidence)),
        );
        if figures.is_empty() {
            results.push(GateResult {
                gate: *gate,
                figure: None,
                nodes: 0,
                nodes_left_out: nodes.len(),
                clips_before: 0,
                clips_after: 0,
                before: None,
                after: None,
                change: None,
                basis: None,
                verdict: if gate.where_measured {
                    Verdict::Passed
                } else {
                    Verdict::Undecided
                },
            });
        }
    }
    results
}

/// All gates together: one failed is failed, one undecided is undecided.
pub fn overall(results: &[GateResult]) -> Verdict {
    let any = |verdict| results.iter().any(|result| result.verdict == verdict);
    if any(Verdict::Failed) {
        Verdict::Failed
    } else if any(Verdict::Undecided) {
        Verdict::Undecided
    } else {
        Verdict::Passed
    }
}

fn judge_one(gate: &Gate, figure: Figure, nodes: &[BeforeAfter], evidence: Evidence) -> GateResult {
    let fewest = evidence.fewest_clips.max(2);
    let pairs: Vec<(&Moments, &Moments, Component)> = nodes
        .iter()
        .filter_map(|node| {
            let (before, after) = (node.before.get(&figure)?, node.after.get(&figure)?);
            let enough = before.count >= fewest && after.count >= fewest;
            let component = change(before, after, gate.relative).filter(|_| enough)?;
            Some((before, after, component))
        })
        .collect();
    let mean = |side: fn(&(&Moments, &Moments, Component)) -> f64| {
        (!pairs.is_empty()).then(|| pairs.iter().map(side).sum::<f64>() / pairs.len() as f64)
    };
    let (before, after) = (mean(|p| p.0.mean), mean(|p| p.1.mean));
    let (clips_before, clips_after) = pairs
        .iter()
        .fold((0, 0), |(b, a), pair| (b + pair.0.count, a + pair.1.count));
    let components: Vec<Component> = pairs
        .into_iter()
        .map(|(_, _, component)| component)
        .collect();
    let (change, basis) = if components.len() >= PAIRED_FROM {
        let differences = Moments::of(components.iter().map(|c| c.value));
        (differences.interval(evidence.level), Some(Basis::Nodes))
    } else {
        let change = mean_of_components(&components, evidence.level);
        (change, change.map(|_| Basis::Clips))
    };
    GateResult {
        gate: *gate,
        figure: Some(figure),
        nodes: components.len(),
        nodes_left_out: nodes.len() - components.len(),
        clips_before,
        clips_after,
        before,
        after,
        change,
        basis,
        verdict: change.map_or(Verdict::Undecided, |change| within(gate, change)),
    }
}

fn within(gate: &Gate, change: Interval) -> Verdict {
    // Turned so that more is worse.
    let (best, worst, bound) = if gate.metric.more_is_worse() {
        (change.lower, change.upper, gate.bound)
    } else {
        (-change.upper, -change.lower, -gate.bound)
    };
    if worst <= bound {
        Verdict::Passed
    } else if best > bound {
        Verdict::Failed
    } else {
        Verdict::Undecided
    }
}

#[cfg(test)]
mod tests;
