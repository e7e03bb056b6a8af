//! The plan of a rollout.

use super::super::gate::Gate;
use super::super::selector::Selector;
use crate::named::as_text;
use albireo_wire::Threshold;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Longest of the times in a plan, seconds.
const LONGEST_S: f64 = 90.0 * 86_400.0;
/// Most stages.
const MOST_STAGES: usize = 20;

/// How many nodes have the new value once a stage has begun: a number, or a share of all, rounded up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum StageSize {
    /// That many.
    Nodes(usize),
    /// That share of all, above 0 and at most 1.
    Share(f64),
}

impl StageSize {
    /// The number out of `all`: at least one, at most all.
    pub fn of(self, all: usize) -> usize {
        let wanted = match self {
            Self::Nodes(nodes) => nodes,
            // A little less, so that 10 % of 30 is three and not, by the product's last digit, four.
            Self::Share(share) => (share * all as f64 - 1e-9).ceil() as usize,
        };
        wanted.clamp(1, all.max(1))
    }
}

/// Why a plan cannot be followed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct PlanError {
    /// The field of the plan.
    pub field: &'static str,
    /// What is wrong and what would do.
    pub reason: String,
}

impl PlanError {
    pub(crate) fn new(field: &'static str, reason: impl Into<String>) -> Self {
        Self {
            field,
            reason: reason.into(),
        }
    }
}

impl FromStr for StageSize {
    type Err = PlanError;

    fn from_str(text: &str) -> Result<Self, PlanError> {
        let fault = || {
            let reason = format!("`{text}` is no size of a stage; write `1`, `10%` or `all`");
            PlanError::new("stages", reason)
        };
        let text = text.trim();
        if text == "all" {
            return Ok(Self::Share(1.0));
        }
        match text.strip_suffix('%') {
            Some(percent) => {
                let percent: f64 = percent.trim().parse().map_err(|_| fault())?;
                // As many digits as are written of it.
                let percent = (percent * 1e4).round() / 1e4;
                let usable = percent > 0.0 && percent <= 100.0;
                usable
                    .then_some(Self::Share(percent / 100.0))
                    .ok_or_else(fault)
            }
            None => match text.parse() {
                Ok(nodes) if nodes > 0 => Ok(Self::Nodes(nodes)),
                _ => Err(fault()),
            },
        }
    }
}

impl fmt::Display for StageSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nodes(nodes) => write!(f, "{nodes}"),
            Self::Share(share) => write!(f, "{}%", (share * 1e6).round() / 1e4),
        }
    }
}

as_text!(StageSize);

/// What happens when a gate fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnFailure {
    /// Every node of the rollout gets its old value back.
    #[default]
    Return,
    /// Nothing changes until a person decides, or the plan's `held_for_s` is over.
    Hold,
}

/// A change in stages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RolloutPlan {
    /// Which nodes.
    #[schema(value_type = Vec<String>)]
    pub select: Selector,
    /// How many nodes have the new value in each stage, all stages before included. Where the last leaves some out, they keep
    /// the old value, and the last stage is measured against them.
    #[schema(value_type = Vec<String>)]
    pub stages: Vec<StageSize>,
    /// How long a stage is held before its gates are judged, seconds.
    pub soak_s: f64,
    /// How much longer a stage is held when its gates could not be judged at the end of the soak, seconds.
    pub patience_s: f64,
    /// How far back the measurements before the change go, seconds.
    pub baseline_s: f64,
    /// What the change may cost.
    #[schema(value_type = Vec<String>)]
    pub gates: Vec<Gate>,
    /// How sure verdicts are: with 0.95, at most one of twenty rollouts without any effect is judged failed, all gates, stages
    /// and looks together, and at most one of twenty changes beyond a bound passes its stage.
    pub confidence: f64,
    /// Fewest clips of a node before and after; those with fewer are left out.
    pub fewest_clips: u64,
    /// What happens when a gate fails.
    pub on_failure: OnFailure,
    /// How long a node in reach may take to report the value, seconds.
    pub apply_within_s: f64,
    /// How long the rollout is held for a person to decide before the old value returns, seconds.
    pub held_for_s: f64,
    /// Share of a stage's nodes in reach that must have reported the value; with fewer the stage has failed.
    pub fewest_applied: f64,
    /// How long a node out of reach may stay away, seconds; then its value is withdrawn and it is named.
    pub offline_deadline_s: f64,
    /// Draws the order of the nodes; chosen by the hub when it is not given.
    pub seed: Option<u64>,
    /// Why.
    pub why: String,
}

impl Default for RolloutPlan {
    fn default() -> Self {
        Self {
            select: Selector::everybody(),
            stages: vec![
                StageSize::Nodes(1),
                StageSize::Share(0.1),
                StageSize::Share(0.5),
                StageSize::Share(1.0),
            ],
            // Nodes vary from hour to hour: a day has enough of them to see a change, a week before it more still.
            soak_s: 86_400.0,
            patience_s: 2.0 * 86_400.0,
            baseline_s: 7.0 * 86_400.0,
            gates: Gate::defaults(),
            confidence: 0.95,
            fewest_clips: 5,
            on_failure: OnFailure::Return,
            apply_within_s: 120.0,
            held_for_s: 86_400.0,
            fewest_applied: 0.9,
            offline_deadline_s: 7.0 * 86_400.0,
            seed: None,
            why: String::new(),
        }
    }
}

impl RolloutPlan {
    /// Whether it can be followed.
    ///
    /// # Errors
    /// [`PlanError`] with the first field that makes no sense.
    pub fn check(&self) -> Result<(), PlanError> {
        let seconds = |field, value: f64, low: f64| {
            // Written so that NaN is refused.
            if value >= low && value <= LONGEST_S {
                Ok(())
            } else {
                let reason = format!("must be from {low} to {LONGEST_S} seconds, not {value}");
                Err(PlanError::new(field, reason))
            }
        };
        seconds("soak_s", self.soak_s, 1.0)?;
        seconds("patience_s", self.patience_s, 0.0)?;
        seconds("baseline_s", self.baseline_s, 1.0)?;
        seconds("apply_within_s", self.apply_within_s, 1.0)?;
        seconds("held_for_s", self.held_for_s, 1.0)?;
        seconds("offline_deadline_s", self.offline_deadline_s, 1.0)?;
        if self.stages.is_empty() || self.stages.len() > MOST_STAGES {
            return Err(PlanError::new(
                "stages",
                format!("must be from 1 to {MOST_STAGES} sizes"),
            ));
        }
        if !(self.confidence > 0.5 && self.confidence < 1.0) {
            let reason = format!("must be above 0.5 and below 1, not {}", self.confidence);
            return Err(PlanError::new("confidence", reason));
        }
        if !(self.fewest_applied > 0.0 && self.fewest_applied <= 1.0) {
            let reason = format!("must be above 0 and at most 1, not {}", self.fewest_applied);
            return Err(PlanError::new("fewest_applied", reason));
        }
        if !(2..=10_000).contains(&self.fewest_clips) {
            let reason = format!("must be from 2 to 10000, not {}", self.fewest_clips);
            return Err(PlanError::new("fewest_clips", reason));
        }
        check_why(&self.why)
    }

    /// The stages over `all` nodes: for each the number of nodes that are new in it. A stage that has none new, in a small fleet,
    /// is left out.
    pub fn new_in_stages(&self, all: usize) -> Vec<usize> {
        let mut have = 0;
        let sizes = self.stages.iter().filter_map(|size| {
            let new = size.of(all).saturating_sub(have);
            have += new;
            (new > 0).then_some(new)
        });
        sizes.collect()
    }
}

/// Whether a reason can be kept.
pub(crate) fn check_why(why: &str) -> Result<(), PlanError> {
    if why.len() > 500 {
        return Err(PlanError::new("why", "must have at most 500 bytes"));
    }
    Ok(())
}

/// A rollout as it is asked for: the value, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutRequest {
    /// The new value.
    pub knob: Threshold,
    /// How.
    pub plan: RolloutPlan,
}
