//! Changes a setting in stages, each gated on what was measured: a state machine without clock, network or database.
//!
//! The caller passes in what it knows of nodes ([`Rollout::observe`]), the time ([`Rollout::tick`]), the measurements it was
//! asked for ([`Rollout::measured`]) and people's commands ([`Rollout::command`]), and reads off which nodes must be asked for
//! which value ([`Rollout::due`]). The whole state is serialised; a rollout read from the database continues where it was.

mod command;
mod plan;
mod record;
mod step;
#[cfg(test)]
mod tests;

pub use command::{Command, CommandError};
pub(crate) use plan::check_why;
pub use plan::{OnFailure, PlanError, RolloutPlan, RolloutRequest, StageSize};
pub use record::{Entry, What};

use super::members::{self, Member, Millis, Observation, Order, Outcome, shuffled};
use super::metric::BeforeAfter;
use albireo_wire::Threshold;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How often at most a stage's gates are judged: half-way (only a failure counts), at the end of the soak, at the
/// end of the patience.
pub(crate) const LOOKS: u8 = 3;

/// Most entries of a rollout's record; the oldest beyond are left out.
const MOST_ENTRIES: usize = 500;

/// Where a rollout is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "phase", rename_all = "snake_case")]
pub enum Phase {
    /// The stage's nodes were asked for the new value; their reports are awaited.
    Applying {
        /// Since when.
        since_ms: Millis,
    },
    /// The stage's nodes have the new value; measuring.
    Soaking {
        /// Since when.
        since_ms: Millis,
        /// How often its gates were judged.
        looks: u8,
    },
    /// Held for a person to decide; after the plan's `held_for_s` the old value returns.
    Held {
        /// Since when.
        since_ms: Millis,
        /// Why.
        reason: String,
    },
    /// All stages have passed; nodes out of reach are awaited until their deadline.
    Finishing {
        /// Since when.
        since_ms: Millis,
    },
    /// All nodes are getting their old values back.
    Returning {
        /// Since when.
        since_ms: Millis,
        /// Why.
        reason: String,
    },
    /// Every stage has passed.
    Done,
    /// Every node in reach has its old value back; the others find it when they return.
    Returned,
    /// Ended by hand, values as they were.
    Stopped,
}

impl Phase {
    /// Its name in messages and tables.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Applying { .. } => "applying",
            Self::Soaking { .. } => "soaking",
            Self::Held { .. } => "held",
            Self::Finishing { .. } => "finishing",
            Self::Returning { .. } => "returning",
            Self::Done => "done",
            Self::Returned => "returned",
            Self::Stopped => "stopped",
        }
    }

    /// Whether nothing more happens by itself or by hand, but a return.
    pub(crate) const fn has_ended(&self) -> bool {
        matches!(self, Self::Done | Self::Returned | Self::Stopped)
    }
}

/// Clips to measure: of the stage's nodes before they were asked and since they have the new value, and over the same hours of
/// the nodes that were not asked yet.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementRequest {
    /// The stage's nodes.
    pub changed: Vec<Window>,
    /// The nodes of later stages, and those that no stage includes.
    pub unchanged: Vec<Window>,
}

/// The two windows of a node, begin and end in milliseconds, with the value that was in force.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// The node.
    pub node: String,
    /// The value before.
    pub old: Threshold,
    /// The baseline.
    pub before_ms: [Millis; 2],
    /// The value after.
    pub new: Threshold,
    /// Since the change.
    pub after_ms: [Millis; 2],
}

/// What was measured, in the order of the request.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurements {
    /// Of the stage's nodes.
    pub changed: Vec<BeforeAfter>,
    /// Of the others.
    pub unchanged: Vec<BeforeAfter>,
}

/// A rollout: its plan, its nodes, where it is, and its record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rollout {
    /// The new value.
    pub knob: Threshold,
    /// How.
    pub plan: RolloutPlan,
    /// The seed that drew the order of the nodes.
    pub seed: u64,
    /// Number of its stages that have nodes.
    pub stages: usize,
    /// The nodes, in the order of their stages.
    pub members: Vec<Member>,
    /// The stage it is in, from 0.
    pub stage: usize,
    /// Where it is.
    pub phase: Phase,
    /// How often this stage was soaked: once, and once more each time a person resumed it after a hold.
    pub soaks: u8,
    /// Since when it is paused.
    pub paused_ms: Option<Millis>,
    /// What happened, oldest first.
    pub record: Vec<Entry>,
    /// Whether measurements were asked for and have not come. Not kept: after a restart they are asked for again.
    #[serde(skip)]
    measuring: bool,
    /// Attempts to measure that failed since the last that did not.
    #[serde(skip)]
    failed_attempts: u8,
}

/// A node that a rollout or trial may take: its name, the value in force, whether it is in reach.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Its name.
    pub node: String,
    /// The value in force.
    pub before: Threshold,
    /// Whether it is in reach.
    pub reachable: bool,
}

impl Rollout {
    /// Begins a rollout on `candidates`: in the order that the seed draws, those in reach first.
    ///
    /// # Errors
    /// [`PlanError`] when the plan makes no sense, or there is no node.
    pub fn begin(
        request: RolloutRequest,
        mut candidates: Vec<Candidate>,
        seed: u64,
        who: &str,
        now: Millis,
    ) -> Result<Self, PlanError> {
        let RolloutRequest { knob, plan } = request;
        plan.check()?;
        if candidates.is_empty() {
            return Err(PlanError::new(
                "select",
                "no node that can take the value is selected",
            ));
        }
        // The draw shall depend on the seed and the nodes alone.
        candidates.sort_by(|a, b| a.node.cmp(&b.node));
        let drawn = shuffled(candidates.len(), seed);
        let (near, far): (Vec<_>, Vec<_>) =
            drawn.into_iter().partition(|i| candidates[*i].reachable);
        let sizes = plan.new_in_stages(candidates.len());
        // Nodes that no stage includes keep the old value: their group is one more than the last stage.
        let stages = (0..)
            .zip(&sizes)
            .flat_map(|(stage, size)| std::iter::repeat_n(stage, *size))
            .chain(std::iter::repeat(sizes.len()));
        let members = near.into_iter().chain(far).zip(stages).map(|(i, stage)| {
            let candidate = &candidates[i];
            Member {
                reachable: candidate.reachable,
                ..Member::new(candidate.node.clone(), stage, candidate.before)
            }
        });
        let mut rollout = Self {
            knob,
            seed,
            stages: sizes.len(),
            members: members.collect(),
            stage: 0,
            phase: Phase::Applying { since_ms: now },
            soaks: 0,
            paused_ms: None,
            record: Vec::new(),
            measuring: false,
            failed_attempts: 0,
            plan,
        };
        rollout.note(now, Entry::by(who, What::Begun));
        rollout.enter_stage(0, now);
        Ok(rollout)
    }

    /// The nodes that have to be asked, by value. Once the request is in the database, [`Rollout::asked`] notes
    /// it.
    pub(crate) fn due(&self) -> Vec<Order> {
        // At its end there may be some too: nodes that missed their deadline get the old value.
        if self.paused_ms.is_some() || self.phase == Phase::Stopped {
            return Vec::new();
        }
        members::due(&self.members, |_| self.knob)
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
        // Time stops in a pause: what nodes report meanwhile is taken as of then.
        let now = self.paused_ms.unwrap_or(now);
        let patience = seconds(self.plan.apply_within_s);
        let mut changed = false;
        for member in &mut self.members {
            let Some(observed) = look(&member.node) else {
                continue;
            };
            member.reachable = observed.reachable;
            if !matches!(
                member.outcome,
                Outcome::Untouched | Outcome::Applied { .. } | Outcome::Missed
            ) {
                changed |= member.observe(&observed, self.knob, patience, now);
            }
        }
        changed
    }

    fn note(&mut self, now: Millis, mut entry: Entry) {
        entry.at_ms = now;
        entry.stage = self.stage + 1;
        if self.record.len() >= MOST_ENTRIES {
            self.record.remove(0);
        }
        self.record.push(entry);
    }
}

pub(super) fn seconds(seconds: f64) -> Millis {
    (seconds * 1000.0) as Millis
}
