//! Judges measurements: the stage of a rollout by its gates, the groups of a trial against the first.

use super::super::effect::{Comparison, Interval, Silence};
use super::super::gate::{ErrorRates, GateResult, Verdict, judge, overall};
use super::super::member::{Member, Millis};
use super::super::metric::{BeforeAfter, Figure};
use super::super::plan::{RolloutPlan, TrialPlan};
use super::{LOOKS, Measured, Run};
use albireo_wire::Threshold;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A figure of one group of a trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArmFigure {
    /// The figure.
    pub figure: Figure,
    /// The number of nodes with enough clips before and during the trial.
    pub nodes: usize,
    /// The number of their clips during the trial.
    pub clips: u64,
    /// Mean over these nodes before.
    pub before: f64,
    /// Mean over these nodes during the trial.
    pub mean: f64,
    /// The group's change beyond that of the first group: a share for energy, EDP and latency, else in the figure's unit. Absent
    /// in the first group, and with fewer than eight nodes in either.
    pub difference: Option<Interval>,
}

/// The result of one value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArmResult {
    /// The value.
    pub value: Threshold,
    /// The number of nodes of the group.
    pub nodes: usize,
    /// The number of them that reported the value.
    pub applied: usize,
    /// The number of those that made clips before the trial and none during it.
    pub silent: usize,
    /// Its figures.
    pub figures: Vec<ArmFigure>,
}

/// The result of a trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TrialResult {
    /// The beginning of the time in which clips counted.
    pub from_ms: Millis,
    /// The end of that time.
    pub until_ms: Millis,
    /// Probability that all intervals together contain the true values.
    pub confidence: f64,
    /// Each value, in the plan's order.
    pub values: Vec<ArmResult>,
}

/// The verdict on a stage.
pub(super) struct Judgement {
    pub(super) verdict: Verdict,
    /// The verdict in words.
    pub(super) text: String,
    /// The result of each gate.
    pub(super) gates: Vec<GateResult>,
}

/// The members on one side of a comparison.
#[derive(Default)]
struct Side<'a> {
    /// The figures of their clips.
    figures: Vec<&'a BeforeAfter>,
    silence: Silence,
}

impl Run {
    /// Judges the stage.
    pub(super) fn judge(&self, plan: &RolloutPlan, found: &Measured) -> Judgement {
        let rates = self.error_rates(plan);
        let changed = self.side(found, |member| {
            self.is_in_stage(member) && member.applied_ms().is_some()
        });
        let unchanged = self.side(found, |member| self.is_later(member));
        let gates = judge(
            &plan.gates,
            &changed.figures,
            &unchanged.figures,
            plan.basics.fewest_clips,
            rates,
        );
        let own = changed.silence;
        let others = unchanged.silence;
        let is_lost = own.by_chance(others) < rates.fail;
        // If too few nodes can be measured, a stage passes when its nodes applied the value and at most half fell silent.
        let is_alive = 2 * own.silent <= own.nodes && own.silent < own.nodes;
        let verdict = if is_lost {
            Verdict::Failed
        } else {
            match overall(&gates) {
                Verdict::Passed | Verdict::NotMeasured if !is_alive => Verdict::Undecided,
                verdict => verdict,
            }
        };
        let silent = format!(
            "{} of {} nodes fell silent, {} of {} of the others",
            own.silent, own.nodes, others.silent, others.nodes
        );
        let text = match verdict {
            Verdict::Passed => "all gates passed".to_owned(),
            Verdict::NotMeasured => {
                format!("the nodes applied the value and are alive, too few to measure; {silent}")
            }
            _ if is_lost || !is_alive => format!("{verdict}: {silent}"),
            _ => format!("{verdict}: {}", named(&gates, verdict)),
        };
        Judgement {
            verdict,
            text,
            gates,
        }
    }

    /// The members on one side of a comparison. Of those that were in reach when the stage began, a node is silent that is out
    /// of reach now, or that had clips before and has none since.
    fn side<'a>(&self, found: &'a Measured, is_on_it: impl Fn(&Member) -> bool) -> Side<'a> {
        let mut side = Side::default();
        for member in self.members.iter().filter(|member| is_on_it(member)) {
            let Some(figures) = found.get(&member.node) else {
                continue;
            };
            side.figures.push(figures);
            if member.was_reachable {
                side.silence.nodes += 1;
                if !member.reachable || figures.fell_silent() {
                    side.silence.silent += 1;
                }
            }
        }
        side
    }

    /// Compares the groups of a trial with the first.
    pub(super) fn compare(&self, plan: &TrialPlan, found: &Measured, now: Millis) -> TrialResult {
        let first = self.applied_in(0, found);
        let mut values = Vec::new();
        for (arm, value) in plan.values.iter().enumerate() {
            let own = self.applied_in(arm, found);
            let mut figures = Vec::new();
            for figure in Figure::ALL {
                if let Some(found) = arm_figure(plan, figure, arm, &own, &first) {
                    figures.push(found);
                }
            }
            values.push(ArmResult {
                value: *value,
                nodes: self.members.iter().filter(|member| member.group == arm).count(),
                applied: own.len(),
                silent: own.iter().filter(|clips| clips.fell_silent()).count(),
                figures,
            });
        }
        TrialResult {
            from_ms: self.since_ms,
            until_ms: now,
            confidence: plan.basics.confidence,
            values,
        }
    }

    /// The figures of the members of a group that reported its value.
    fn applied_in<'a>(&self, arm: usize, found: &'a Measured) -> Vec<&'a BeforeAfter> {
        let applied = self.side(found, |member| {
            member.group == arm && member.applied_ms().is_some()
        });
        applied.figures
    }

    /// The error rates of one look at one figure. The plan's error of failing without cause is divided among all stages, gates
    /// and looks; each resumption gets half of the soak before it. The error of passing is divided only among the looks that
    /// can pass, because every stage has to pass every gate.
    pub(super) fn error_rates(&self, plan: &RolloutPlan) -> ErrorRates {
        let error = (1.0 - plan.basics.confidence) * 0.5_f64.powi(i32::from(self.soaks));
        let figures: usize = plan.gates.iter().map(|gate| gate.metric.figures().count()).sum();
        // One more for nodes that fall silent.
        let tests = (self.stage_count() * (figures + 1)) as f64 * f64::from(LOOKS);
        ErrorRates {
            fail: error / tests,
            pass: error / f64::from(LOOKS - 1),
        }
    }
}

/// A figure of a group of a trial; `None` if no node has enough clips.
fn arm_figure(
    plan: &TrialPlan,
    figure: Figure,
    arm: usize,
    own: &[&BeforeAfter],
    first: &[&BeforeAfter],
) -> Option<ArmFigure> {
    let intervals = (Figure::ALL.len() * (plan.values.len() - 1)) as f64;
    let miss = (1.0 - plan.basics.confidence) / intervals / 2.0;
    let fewest = plan.basics.fewest_clips;
    let found = Comparison::of(figure, figure.scale(), own, first, fewest);
    let means = found.means?;
    // Of the nodes that were compared.
    let clips = own
        .iter()
        .filter(|node| node.means(figure, fewest).is_some())
        .filter_map(|node| node.after.get(&figure))
        .map(|mean| mean.clips)
        .sum();
    Some(ArmFigure {
        figure,
        nodes: found.nodes,
        clips,
        before: means.before,
        mean: means.after,
        // The first group is what the others are compared with.
        difference: match found.effect {
            Some(effect) if arm > 0 => Some(effect.interval(miss)),
            _ => None,
        },
    })
}

/// Names the gates with that verdict.
fn named(results: &[GateResult], verdict: Verdict) -> String {
    let names: Vec<String> = results
        .iter()
        .filter(|result| result.verdict == verdict)
        .map(|result| match result.figure {
            Some(figure) => format!("{} ({figure})", result.gate),
            None => format!("{} (not measured)", result.gate),
        })
        .collect();
    names.join(", ")
}
