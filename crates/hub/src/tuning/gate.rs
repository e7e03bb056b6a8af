//! Judges gates, the bounds on what a change may cost.
//!
//! A gate bounds the change of a metric: `joules<=+5%` (relative), `skip_rate>=-0.05` (absolute). The change is estimated as
//! [`effect`](super::effect) describes. If its whole interval is within the bound, the gate passes; if it is beyond the
//! bound, the gate fails; otherwise it is undecided, and more clips are needed.

use super::effect::{Comparison, Effect, Interval, Scale};
use super::metric::{BeforeAfter, Figure, Metric};
use crate::named::named;
use serde::{Deserialize, Serialize};
use serde_with::{DeserializeFromStr, SerializeDisplay};
use std::fmt;
use std::str::FromStr;
use utoipa::ToSchema;

/// A bound on the change of one metric.
#[derive(Clone, Copy, Debug, PartialEq, DeserializeFromStr, SerializeDisplay)]
pub struct Gate {
    /// The metric.
    pub metric: Metric,
    /// The bound as written: percent of the value before if relative, else in the metric's unit.
    pub number: f64,
    /// The scale of the bound.
    pub scale: Scale,
    /// True if the gate passes when no node reports the metric; otherwise it is undecided then.
    pub where_measured: bool,
}

impl Gate {
    /// The default gates: the skip rate may fall by 0.05, the energy of a clip may rise by 5 %, the 99th percentile of the
    /// latency by 10 %, the share of degraded frames by 0.01.
    pub fn defaults() -> Vec<Self> {
        let texts = [
            "skip_rate>=-0.05",
            "joules<=+5%?",
            "latency_p99<=+10%",
            "degraded<=+0.01",
        ];
        texts.iter().filter_map(|text| text.parse().ok()).collect()
    }

    /// The bound: a share of the value before if relative, else in the metric's unit.
    fn bound(&self) -> f64 {
        match self.scale {
            Scale::Relative => self.number / 100.0,
            Scale::Absolute => self.number,
        }
    }

    /// The verdict on an effect.
    fn judge(&self, effect: &Effect, rates: ErrorRates) -> Verdict {
        let fail = effect.interval(rates.fail);
        let pass = effect.interval(rates.pass);
        let bound = self.bound();
        let more_is_worse = self.metric.more_is_worse();
        let is_beyond = if more_is_worse {
            fail.lower > bound
        } else {
            fail.upper < bound
        };
        if is_beyond {
            return Verdict::Failed;
        }
        let is_within = if more_is_worse {
            pass.upper <= bound
        } else {
            pass.lower >= bound
        };
        if is_within {
            Verdict::Passed
        } else {
            Verdict::Undecided
        }
    }
}

impl FromStr for Gate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let fault = |reason: String| {
            format!(
                "`{text}` is not a gate: {reason}; write for example `joules<=+5%` or `skip_rate>=-0.05`"
            )
        };
        let trimmed = text.trim();
        let condition = trimmed.strip_suffix('?');
        let change = condition.unwrap_or(trimmed);
        let found = Metric::ALL.into_iter().find_map(|metric| {
            let behind_name = change.strip_prefix(metric.name())?.trim_start();
            let bound = behind_name.strip_prefix(metric.sign())?.trim();
            Some((metric, bound))
        });
        let (metric, bound) = found.ok_or_else(|| {
            let begin = Metric::ALL.map(|metric| format!("{metric}{}", metric.sign()));
            fault(format!("it must begin with one of {}", begin.join(", ")))
        })?;
        let (digits, scale) = match bound.strip_suffix('%') {
            Some(percent) => (percent.trim_end(), Scale::Relative),
            None => (bound, Scale::Absolute),
        };
        let number = match digits.parse::<f64>() {
            Ok(number) if number.is_finite() => number,
            _ => return Err(fault(format!("`{bound}` is not a number"))),
        };
        Ok(Self {
            metric,
            number,
            scale,
            where_measured: condition.is_some(),
        })
    }
}

impl fmt::Display for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let metric = self.metric;
        let sign = self.metric.sign();
        let number = self.number;
        let percent = match self.scale {
            Scale::Relative => "%",
            Scale::Absolute => "",
        };
        let where_measured = if self.where_measured { "?" } else { "" };
        write!(f, "{metric}{sign}{number:+}{percent}{where_measured}")
    }
}

named! {
    /// The verdict of a gate or a stage, the best first.
    pub enum Verdict {
        /// The change is within the bound.
        Passed = "passed",
        /// Too few nodes were measured to estimate the change.
        NotMeasured = "not_measured",
        /// The interval contains the bound.
        Undecided = "undecided",
        /// The change is beyond the bound.
        Failed = "failed",
    }
}

/// A gate's verdict on one figure, with its numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GateResult {
    /// The gate, as written.
    #[schema(value_type = String)]
    pub gate: Gate,
    /// The figure; absent when no node reports the metric.
    pub figure: Option<Figure>,
    /// The number of changed nodes with enough clips before and after.
    pub nodes: usize,
    /// The number of unchanged nodes with enough clips over the same hours.
    pub compared: usize,
    /// Mean over the changed nodes before; absent if there are none.
    pub before: Option<f64>,
    /// Mean over the changed nodes after; absent if there are none.
    pub after: Option<f64>,
    /// The change beyond that of the unchanged nodes: a share of the value before if the gate is relative.
    pub change: Option<Interval>,
    /// The verdict.
    pub verdict: Verdict,
}

/// The probabilities that one look at one figure is wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorRates {
    /// Probability of a failure without cause.
    pub fail: f64,
    /// Probability that a change beyond the bound passes.
    pub pass: f64,
}

/// Judges every gate on each of its figures: compares changed with unchanged nodes, each with at least `fewest_clips` before
/// and after.
pub(crate) fn judge(
    gates: &[Gate],
    changed: &[&BeforeAfter],
    unchanged: &[&BeforeAfter],
    fewest_clips: u64,
    rates: ErrorRates,
) -> Vec<GateResult> {
    let reported = |figure: &Figure| {
        changed
            .iter()
            .any(|node| node.before.contains_key(figure) || node.after.contains_key(figure))
    };
    let mut results = Vec::new();
    for gate in gates {
        let mut figures: Vec<_> = gate.metric.figures().filter(reported).map(Some).collect();
        if figures.is_empty() {
            figures.push(None);
        }
        for figure in figures {
            let found = match figure {
                Some(figure) => {
                    Comparison::of(figure, gate.scale, changed, unchanged, fewest_clips)
                }
                None => Comparison::default(),
            };
            let verdict = match (found.effect, figure) {
                (Some(effect), _) => gate.judge(&effect, rates),
                (None, Some(_)) => Verdict::NotMeasured,
                (None, None) if gate.where_measured => Verdict::Passed,
                (None, None) => Verdict::Undecided,
            };
            results.push(GateResult {
                gate: *gate,
                figure,
                nodes: found.nodes,
                compared: found.compared,
                before: found.means.map(|means| means.before),
                after: found.means.map(|means| means.after),
                change: found.effect.map(|effect| effect.interval(rates.fail)),
                verdict,
            });
        }
    }
    results
}

/// The verdict of all gates together: the worst one.
pub(crate) fn overall(results: &[GateResult]) -> Verdict {
    results.iter().map(|result| result.verdict).max().unwrap_or(Verdict::Passed)
}

#[cfg(test)]
mod tests;
