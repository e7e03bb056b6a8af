//! Values compared on random groups of nodes over the same time: the fleet's own frontier, measured.
//!
//! The nodes are dealt at random into as many groups as there are values, each gets its group's value for the trial's
//! time, and then its old value back. What differs between the groups beyond chance is the values' doing, for nothing but the draw
//! decided who is in which.

#[cfg(test)]
mod tests;

use super::members::{Member, Millis, Outcome, Seen, Target, shuffled};
use super::metric::{Figure, Figures};
use super::rollout::{Candidate, Order, PlanError, check_why};
use super::selector::Selector;
use super::statistics::{Interval, Moments, difference};
use albireo_wire::Threshold;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Most values of a trial.
const MOST_ARMS: usize = 20;
/// Fewest nodes of a group: one has no spread.
const FEWEST_NODES: usize = 2;

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
    /// How long a node in reach may take to report its value, seconds; one that takes longer is not in the result.
    pub apply_within_s: f64,
    /// Fewest clips of a node in the result.
    pub fewest_clips: u64,
    /// Level of the intervals.
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
                return Err(PlanError::new(
                    "values",
                    format!("{value} stands there twice"),
                ));
            }
            if value.name != self.values[0].name {
                return fault("values", "must be values of one knob");
            }
        }
        let day = 86_400.0;
        if !(self.duration_s >= 1.0 && self.duration_s <= 90.0 * day) {
            return fault("duration_s", "must be from 1 second to 90 days");
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
    /// Nodes that have it, with enough clips.
    pub nodes: u64,
    /// Their clips.
    pub clips: u64,
    /// Mean over the nodes.
    pub mean: f64,
    /// The same with its interval; absent with fewer than two nodes.
    pub interval: Option<Interval>,
    /// Difference from the first group with its interval (Welch); absent in the first group, and where either has fewer than two
    /// nodes.
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
    /// Level of the intervals.
    pub confidence: f64,
    /// Each value, in the plan's order.
    pub values: Vec<ArmResult>,
}

/// What is to be measured for a trial: clips of each node with its value, in the window.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialWindow {
    /// Nodes that have their value, with it.
    pub nodes: Vec<(String, Threshold)>,
    /// Begin.
    pub from_ms: Millis,
    /// End.
    pub until_ms: Millis,
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
    /// What was measured, once it is over.
    pub result: Option<TrialResult>,
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
        })
    }

    /// The nodes that have to be asked, by value.
    pub fn due(&self) -> Vec<Order> {
        let mut orders: Vec<Order> = Vec::new();
        for member in self.members.iter().filter(|member| member.is_due()) {
            let is_return = member.target == Target::Old;
            let knob = if is_return {
                member.before
            } else {
                self.plan.values[member.group]
            };
            match orders
                .iter_mut()
                .find(|o| o.knob == knob && o.is_return == is_return)
            {
                Some(order) => order.nodes.push(member.node.clone()),
                None => orders.push(Order {
                    knob,
                    nodes: vec![member.node.clone()],
                    is_return,
                }),
            }
        }
        orders
    }

    /// Notes that the nodes of `order` were asked, with that revision.
    pub fn asked(&mut self, order: &Order, revision: u64, now: Millis) {
        let named: std::collections::HashSet<&str> =
            order.nodes.iter().map(String::as_str).collect();
        for member in self
            .members
            .iter_mut()
            .filter(|m| m.is_due() && named.contains(m.node.as_str()))
        {
            member.asked(revision, now);
        }
    }

    /// Takes in what is known of nodes. Returns whether anything changed.
    pub fn observe(&mut self, now: Millis, look: impl Fn(&str) -> Option<Seen>) -> bool {
        let patience = super::rollout::seconds(self.plan.apply_within_s);
        let mut changed = false;
        for member in &mut self.members {
            if member.outcome.applied_at().is_some() {
                continue;
            }
            if let Some(seen) = look(&member.node) {
                changed |= member.observe(&seen, self.plan.values[member.group], patience, now);
            }
        }
        changed
    }

    /// Lets time pass. Returns what has to be measured when the time is over.
    pub fn tick(&mut self, now: Millis) -> Option<TrialWindow> {
        let patience = super::rollout::seconds(self.plan.apply_within_s);
        let settled = self
            .members
            .iter()
            .all(|m| !m.is_due() && m.outcome.is_decided());
        match self.phase {
            TrialPhase::Applying { since_ms } if settled || now - since_ms >= 2 * patience => {
                self.phase = TrialPhase::Running { since_ms: now };
            }
            TrialPhase::Running { since_ms }
                if now - since_ms >= super::rollout::seconds(self.plan.duration_s) =>
            {
                return Some(self.window(now));
            }
            TrialPhase::Returning { since_ms } if settled || now - since_ms >= 4 * patience => {
                self.phase = TrialPhase::Done;
            }
            _ => {}
        }
        None
    }

    /// What is measured if the trial ends now.
    pub fn window(&self, now: Millis) -> TrialWindow {
        let from_ms = match self.phase {
            TrialPhase::Running { since_ms } => since_ms,
            _ => now,
        };
        let has_it = |m: &&Member| m.asked == Target::New && m.outcome.applied_at().is_some();
        let nodes = self.members.iter().filter(has_it);
        TrialWindow {
            nodes: nodes
                .map(|m| (m.node.clone(), self.plan.values[m.group]))
                .collect(),
            from_ms,
            until_ms: now,
        }
    }

    /// Ends the trial with what was measured over `window`; the old values return.
    pub fn end(
        &mut self,
        window: &TrialWindow,
        measured: &BTreeMap<String, Figures>,
        who: Option<&str>,
        now: Millis,
    ) {
        if !matches!(
            self.phase,
            TrialPhase::Applying { .. } | TrialPhase::Running { .. }
        ) {
            return;
        }
        self.result = Some(self.compare(window, measured));
        self.ended_by = who.map(str::to_owned);
        for member in &mut self.members {
            member.aim(Target::Old);
            if member.asked == Target::Untouched {
                member.outcome = Outcome::Untouched;
            }
        }
        self.phase = TrialPhase::Returning { since_ms: now };
    }

    /// The groups beside each other.
    pub fn compare(
        &self,
        window: &TrialWindow,
        measured: &BTreeMap<String, Figures>,
    ) -> TrialResult {
        let level = self.plan.confidence;
        let group = |arm: usize, figure: Figure| {
            let (mut means, mut clips) = (Moments::default(), 0);
            for member in self.members.iter().filter(|m| m.group == arm) {
                let of_node = measured
                    .get(&member.node)
                    .and_then(|figures| figures.get(&figure));
                if let Some(of_node) = of_node.filter(|m| m.count >= self.plan.fewest_clips) {
                    means.add(of_node.mean);
                    clips += of_node.count;
                }
            }
            (means, clips)
        };
        let arm = |(arm, value): (usize, &Threshold)| {
            let figures = Figure::ALL.into_iter().filter_map(|figure| {
                let (means, clips) = group(arm, figure);
                (means.count > 0).then(|| ArmFigure {
                    figure,
                    nodes: means.count,
                    clips,
                    mean: means.mean,
                    interval: means.interval(level),
                    difference: (arm > 0)
                        .then(|| difference(&group(0, figure).0, &means, level))
                        .flatten(),
                })
            });
            let of_group = || self.members.iter().filter(move |m| m.group == arm);
            ArmResult {
                value: *value,
                nodes: of_group().count(),
                applied: of_group()
                    .filter(|m| window.nodes.iter().any(|(node, _)| *node == m.node))
                    .count(),
                figures: figures.collect(),
            }
        };
        TrialResult {
            from_ms: window.from_ms,
            until_ms: window.until_ms,
            confidence: level,
            values: self.plan.values.iter().enumerate().map(arm).collect(),
        }
    }
}
