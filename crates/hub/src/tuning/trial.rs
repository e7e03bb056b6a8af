//! Compares values on random groups of nodes over the same time.
//!
//! The nodes are assigned at random to as many groups as there are values. Each gets its group's value for the trial's
//! duration, and then its old value back. Each group's change is estimated beside that of the first
//! ([`effect`](super::effect)); only the draw decided which node is in which group.

#[cfg(test)]
mod tests;

use super::effect::{Effect, FEWEST_NODES, Interval};
use super::members::{self, Member, Millis, Observation, Order, Outcome, Target, shuffled};
use super::metric::{BeforeAfter, Figure};
use super::rollout::{Candidate, PlanError, Window, check_why, seconds};
use super::selector::Selector;
use albireo_wire::Threshold;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most values of a trial.
const MOST_ARMS: usize = 20;
/// Attempts to measure before a trial ends without a result.
const ATTEMPTS: u8 = 20;

/// A comparison of values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrialPlan {
    /// The values, two or more of one knob.
    pub values: Vec<Threshold>,
    /// Which nodes.
    #[schema(value_type = Vec<String>)]
    pub select: Selector,
    /// How long the values hold once the nodes have reported them, seconds.
    pub duration_s: f64,
    /// How far back the measurements before the trial go, seconds.
    pub baseline_s: f64,
    /// How long a node in reach may take to report its value, seconds; one that takes longer is not in the result.
    pub apply_within_s: f64,
    /// Fewest clips of a node before and during the trial; those with fewer are left out.
    pub fewest_clips: u64,
    /// Probability that all intervals of the result hold the truth together.
    pub confidence: f64,
    /// Draws the groups; chosen by the hub when it is not given.
    pub seed: Option<u64>,
    /// Why.
    pub why: String,
}

impl Default for TrialPlan {
    fn default() -> Self {
        Self {
            values: Vec::new(),
            select: Selector::everybody(),
            duration_s: 3_600.0,
            baseline_s: 3_600.0,
            apply_within_s: 120.0,
            fewest_clips: 5,
            confidence: 0.95,
            seed: None,
            why: String::new(),
        }
    }
}

impl TrialPlan {
    /// Whether it can be followed.
    ///
    /// # Errors
    /// [`PlanError`] with the first field that makes no sense.
    pub fn check(&self) -> Result<(), PlanError> {
        let fault = |field, reason: &str| Err(PlanError::new(field, reason));
        if !(2..=MOST_ARMS).contains(&self.values.len()) {
            return fault("values", "must be from 2 to 20 values");
        }
        for (i, value) in self.values.iter().enumerate() {
            if self.values[..i].contains(value) {
                return Err(PlanError::new("values", format!("{value} is named twice")));
            }
            if value.name != self.values[0].name {
                return fault("values", "must be values of one knob");
            }
        }
        let day = 86_400.0;
        if !(self.duration_s >= 1.0 && self.duration_s <= 90.0 * day) {
            return fault("duration_s", "must be from 1 second to 90 days");
        }
        if !(self.baseline_s >= 1.0 && self.baseline_s <= 90.0 * day) {
            return fault("baseline_s", "must be from 1 second to 90 days");
        }
        if !(self.apply_within_s >= 1.0 && self.apply_within_s <= day) {
            return fault("apply_within_s", "must be from 1 second to a day");
        }
        if !(1..=10_000).contains(&self.fewest_clips) {
            return fault("fewest_clips", "must be from 1 to 10000");
        }
        if !(self.confidence > 0.5 && self.confidence < 1.0) {
            return fault("confidence", "must be above 0.5 and below 1");
        }
        check_why(&self.why)
    }
}

/// Where a trial is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "phase", rename_all = "snake_case")]
pub enum TrialPhase {
    /// The nodes were asked for their values.
    Applying {
        /// Since when.
        since_ms: Millis,
    },
    /// Every node in reach has its value.
    Running {
        /// Since when: clips from then on count.
        since_ms: Millis,
    },
    /// It is over, and the nodes are getting their old values back.
    Returning {
        /// Since when.
        since_ms: Millis,
    },
    /// Over.
    Done,
}

impl TrialPhase {
    /// Its name in messages and tables.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Applying { .. } => "applying",
            Self::Running { .. } => "running",
            Self::Returning { .. } => "returning",
            Self::Done => "done",
        }
    }
}

/// A figure of one group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArmFigure {
    /// What.
    pub figure: Figure,
    /// Nodes that have it, with enough clips before and during the trial.
    pub nodes: usize,
    /// Their clips during the trial.
    pub clips: u64,
    /// Mean over these nodes before.
    pub before: f64,
    /// Mean over these nodes during the trial.
    pub mean: f64,
    /// The group's change beyond that of the first group: a share for energy, EDP and latency, else in the figure's unit. Absent
    /// in the first group, and with fewer than eight nodes in either.
    pub difference: Option<Interval>,
}

/// What one value came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArmResult {
    /// The value.
    pub value: Threshold,
    /// Nodes of the group.
    pub nodes: usize,
    /// Of them, those that reported the value.
    pub applied: usize,
    /// Of those, how many made clips before the trial and none during it.
    pub silent: usize,
    /// Its figures.
    pub figures: Vec<ArmFigure>,
}

/// What a trial measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TrialResult {
    /// From when on clips counted.
    pub from_ms: Millis,
    /// Until when.
    pub until_ms: Millis,
    /// Probability that all intervals hold the truth together.
    pub confidence: f64,
    /// Each value, in the plan's order.
    pub values: Vec<ArmResult>,
}

/// A trial: its plan, its groups, where it is, and what it measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// How.
    pub plan: TrialPlan,
    /// The seed that drew the groups.
    pub seed: u64,
    /// The nodes; [`Member::group`] is the number of the value.
    pub members: Vec<Member>,
    /// Where it is.
    pub phase: TrialPhase,
    /// Who ended it before its time.
    pub ended_by: Option<String>,
    /// What was measured, once it is over; absent when it could not be measured.
    pub result: Option<TrialResult>,
    /// Attempts to measure that failed.
    #[serde(default)]
    failed_attempts: u8,
}

impl Trial {
    /// Begins a trial on `candidates`: those in reach only, since the others would not be measured.
    ///
    /// # Errors
    /// [`PlanError`] when the plan makes no sense, or there are too few nodes.
    pub fn begin(
        plan: TrialPlan,
        candidates: Vec<Candidate>,
        seed: u64,
        now: Millis,
    ) -> Result<Self, PlanError> {
        plan.check()?;
        let mut near: Vec<_> = candidates.into_iter().filter(|c| c.reachable).collect();
        let arms = plan.values.len();
        if near.len() < arms * FEWEST_NODES {
            let reason = format!(
                "{} nodes in reach are too few for {arms} values: each needs {FEWEST_NODES} at least",
                near.len()
            );
            return Err(PlanError::new("select", reason));
        }
        near.sort_by(|a, b| a.node.cmp(&b.node));
        let deal = |(place, i): (usize, usize)| {
            let mut member = Member::new(near[i].node.clone(), place % arms, near[i].before);
            member.aim(Target::New);
            member.outcome = Outcome::Pending;
            member
        };
        let members = shuffled(near.len(), seed)
            .into_iter()
            .enumerate()
            .map(deal)
            .collect();
        Ok(Self {
            plan,
            seed,
            members,
            phase: TrialPhase::Applying { since_ms: now },
            ended_by: None,
            result: None,
            failed_attempts: 0,
        })
    }

    /// The nodes that have to be asked, by value.
    pub(crate) fn due(&self) -> Vec<Order> {
        members::due(&self.members, |member| self.plan.values[member.group])
    }

    /// Notes that the nodes of `order` were asked, with that revision.
    pub fn asked(&mut self, order: &Order, revision: u64, now: Millis) {
        members::asked(&mut self.members, order, revision, now);
    }

    /// Takes in what is known of nodes. Returns whether anything changed.
    pub(crate) fn observe(
        &mut self,
        now: Millis,
        look: impl Fn(&str) -> Option<Observation>,
    ) -> bool {
        let patience = seconds(self.plan.apply_within_s);
        let mut changed = false;
        for member in &mut self.members {
            if member.outcome.applied_at().is_some() {
                continue;
            }
            if let Some(observed) = look(&member.node) {
                changed |= member.observe(&observed, self.plan.values[member.group], patience, now);
            }
        }
        changed
    }

    /// Lets time pass. Returns what has to be measured when the time is over.
    pub fn tick(&mut self, now: Millis) -> Option<Vec<Window>> {
        let patience = seconds(self.plan.apply_within_s);
        let settled = self
            .members
            .iter()
            .all(|m| !m.is_due() && m.outcome.is_decided());
        match self.phase {
            TrialPhase::Applying { since_ms } if settled || now - since_ms >= 2 * patience => {
                self.phase = TrialPhase::Running { since_ms: now };
            }
            TrialPhase::Running { since_ms } if now - since_ms >= seconds(self.plan.duration_s) => {
                return Some(self.windows(now));
            }
            TrialPhase::Returning { since_ms } if settled || now - since_ms >= 4 * patience => {
                self.phase = TrialPhase::Done;
            }
            _ => {}
        }
        None
    }

    /// What to measure if the trial ends now: the nodes that have their value.
    pub(crate) fn windows(&self, now: Millis) -> Vec<Window> {
        let from = self.measured_from(now);
        let baseline = seconds(self.plan.baseline_s);
        let window = |member: &Member| Window {
            node: member.node.clone(),
            old: member.before,
            before_ms: [member.asked_ms - baseline, member.asked_ms],
            new: self.plan.values[member.group],
            after_ms: [from, now],
        };
        self.members.iter().filter(has_it).map(window).collect()
    }

    fn measured_from(&self, now: Millis) -> Millis {
        match self.phase {
            TrialPhase::Running { since_ms } => since_ms,
            _ => now,
        }
    }

    /// The measurements failed. They are asked for again at the next tick; after many attempts the trial ends without a result.
    pub(crate) fn not_measured(&mut self, now: Millis) {
        self.failed_attempts += 1;
        if self.failed_attempts >= ATTEMPTS {
            self.give_back(now);
        }
    }

    /// Ends the trial with what was measured, in the order of [`windows`](Self::windows); the old values return.
    pub fn end(&mut self, measured: &[BeforeAfter], who: Option<&str>, now: Millis) {
        if !matches!(
            self.phase,
            TrialPhase::Applying { .. } | TrialPhase::Running { .. }
        ) {
            return;
        }
        self.result = Some(self.compare(measured, now));
        self.ended_by = who.map(str::to_owned);
        self.give_back(now);
    }

    fn give_back(&mut self, now: Millis) {
        self.members.iter_mut().for_each(Member::give_back);
        self.phase = TrialPhase::Returning { since_ms: now };
    }

    /// The groups beside the first.
    fn compare(&self, measured: &[BeforeAfter], now: Millis) -> TrialResult {
        let arms = self.plan.values.len();
        let intervals = (Figure::ALL.len() * (arms - 1)) as f64;
        let miss = (1.0 - self.plan.confidence) / intervals / 2.0;
        let nodes = |arm: usize| {
            (self.members.iter().filter(has_it).zip(measured))
                .filter(move |(member, _)| member.group == arm)
                .map(|(_, clips)| clips)
        };
        let figure = |arm: usize, figure: Figure| {
            let means = |arm| BeforeAfter::means(nodes(arm), figure, self.plan.fewest_clips);
            let (own, scale) = (means(arm), figure.scale());
            let count = own.len() as f64;
            let effect = (arm > 0)
                .then(|| Effect::of(scale, &scale.changes(&own), &scale.changes(&means(0))));
            (!own.is_empty()).then(|| ArmFigure {
                figure,
                nodes: own.len(),
                clips: (nodes(arm))
                    .filter_map(|node| node.after.get(&figure))
                    .map(|mean| mean.clips)
                    .sum(),
                before: own.iter().map(|(before, _)| before).sum::<f64>() / count,
                mean: own.iter().map(|(_, after)| after).sum::<f64>() / count,
                difference: effect.flatten().map(|effect| effect.interval(miss)),
            })
        };
        let arm = |(arm, value): (usize, &Threshold)| ArmResult {
            value: *value,
            nodes: self.members.iter().filter(|m| m.group == arm).count(),
            applied: nodes(arm).count(),
            silent: nodes(arm).filter(|clips| clips.fell_silent()).count(),
            figures: (Figure::ALL.into_iter())
                .filter_map(|of| figure(arm, of))
                .collect(),
        };
        TrialResult {
            from_ms: self.measured_from(now),
            until_ms: now,
            confidence: self.plan.confidence,
            values: self.plan.values.iter().enumerate().map(arm).collect(),
        }
    }
}

/// Whether the node reported its group's value.
fn has_it(member: &&Member) -> bool {
    member.asked == Target::New && member.outcome.applied_at().is_some()
}
