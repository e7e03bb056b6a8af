//! Defines and checks the plans of rollouts and trials.

use super::gate::Gate;
use super::selector::Selector;
use albireo_service::config::DAY_S;
use albireo_wire::Threshold;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::RangeInclusive;
use utoipa::ToSchema;

/// The longest time in a plan, seconds.
const LONGEST_S: f64 = 90.0 * DAY_S;
/// Most stages, and most values of a trial.
const MOST: usize = 20;
/// Longest reason, bytes.
const LONGEST_WHY: usize = 500;

/// The size of a stage.
#[derive(Clone, Copy, Debug)]
pub(crate) enum StageSize {
    /// So many nodes.
    Nodes(usize),
    /// So many per cent of all nodes.
    Percent(f64),
}

impl StageSize {
    /// Reads `1`, `10%` or `all`. `None` if it is no size.
    pub(crate) fn of(text: &str) -> Option<Self> {
        let text = text.trim();
        if text == "all" {
            return Some(Self::Percent(100.0));
        }
        let Some(percent) = text.strip_suffix('%') else {
            let nodes: usize = text.parse().ok()?;
            return (nodes > 0).then_some(Self::Nodes(nodes));
        };
        let percent: f64 = percent.trim().parse().ok()?;
        (percent > 0.0 && percent <= 100.0).then_some(Self::Percent(percent))
    }

    /// The number of nodes out of `all` that it means, at least one and at most all; a share is rounded up.
    pub(crate) fn nodes(self, all: usize) -> usize {
        let wanted = match self {
            Self::Nodes(nodes) => nodes,
            // A little less, so that a rounding error does not make 10 % of 30 four nodes.
            Self::Percent(percent) => (percent / 100.0 * all as f64 - 1e-9).ceil() as usize,
        };
        wanted.clamp(1, all.max(1))
    }

    /// True if it is more than another size whatever the number of nodes: of a number and a share, only all nodes are.
    fn exceeds(self, other: Self) -> bool {
        match (self, other) {
            (Self::Nodes(nodes), Self::Nodes(others)) => nodes > others,
            (Self::Percent(percent), Self::Percent(others)) => percent > others,
            (Self::Percent(percent), Self::Nodes(_)) => percent >= 100.0,
            (Self::Nodes(_), Self::Percent(_)) => false,
        }
    }
}

/// The reaction of a rollout to a failed gate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnFailure {
    /// Every node of the rollout gets its old value back.
    #[default]
    Return,
    /// It waits until a person decides, or the plan's `held_for_s` is over.
    Hold,
}

/// The fields that the plans of rollouts and trials share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct Basics {
    /// Selects the nodes.
    #[schema(value_type = Vec<String>)]
    pub select: Selector,
    /// The length of the baseline before the change, seconds.
    pub baseline_s: f64,
    /// Time that a reachable node has to report the value, seconds.
    pub apply_within_s: f64,
    /// Fewest clips of a node before and after; nodes with fewer are left out.
    pub fewest_clips: u64,
    /// The confidence of verdicts. With 0.95, at most one of twenty rollouts without any effect fails, over all gates, stages
    /// and looks together, and at most one of twenty changes beyond a bound passes its stage. For a trial it is the
    /// probability that all intervals together contain the true values.
    pub confidence: f64,
    /// The seed that draws the order of the nodes, or the groups; by default the hub chooses one.
    pub seed: Option<u64>,
    /// The reason, for the history.
    pub why: String,
}

impl Default for Basics {
    fn default() -> Self {
        Self {
            select: Selector::default(),
            // A node's figures vary over the day and the week.
            baseline_s: 7.0 * DAY_S,
            apply_within_s: 120.0,
            fewest_clips: 5,
            confidence: 0.95,
            seed: None,
            why: String::new(),
        }
    }
}

/// A change in stages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct RolloutPlan {
    /// The fields that a trial has too.
    #[serde(flatten)]
    pub basics: Basics,
    /// The number of nodes that have the new value in each stage, earlier stages included: `1`, `10%`, `all`. Nodes that the
    /// last stage leaves out keep the old value, and the last stage is compared with them.
    pub stages: Vec<String>,
    /// Time that a stage soaks before its gates are judged, seconds.
    pub soak_s: f64,
    /// Further time that a stage soaks if its gates are undecided at the end of the soak, seconds.
    pub patience_s: f64,
    /// The gates, which bound what the change may cost.
    #[schema(value_type = Vec<String>)]
    pub gates: Vec<Gate>,
    /// The reaction to a failed gate.
    pub on_failure: OnFailure,
    /// Time that the rollout is held for a person to decide before the old value returns, seconds.
    pub held_for_s: f64,
    /// Share of a stage's reachable nodes that must report the value; with fewer the stage fails.
    pub fewest_applied: f64,
    /// Time that a node may stay out of reach, seconds; then its value is withdrawn, and the record names it.
    pub offline_deadline_s: f64,
}

impl Default for RolloutPlan {
    fn default() -> Self {
        Self {
            basics: Basics::default(),
            // Below 100 %: a stage is compared with the nodes that still have the old value.
            stages: ["1", "10%", "50%", "90%"].map(str::to_owned).to_vec(),
            // A day covers all hours.
            soak_s: DAY_S,
            patience_s: 2.0 * DAY_S,
            gates: Gate::defaults(),
            on_failure: OnFailure::Return,
            held_for_s: DAY_S,
            fewest_applied: 0.9,
            offline_deadline_s: 7.0 * DAY_S,
        }
    }
}

/// A comparison of values on random groups of nodes over the same time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct TrialPlan {
    /// The fields that a rollout has too.
    #[serde(flatten)]
    pub basics: Basics,
    /// The values, two or more of one threshold; each is compared with the first.
    pub values: Vec<Threshold>,
    /// Time that the nodes keep the values once they have reported them, seconds.
    pub duration_s: f64,
}

impl Default for TrialPlan {
    fn default() -> Self {
        Self {
            basics: Basics::default(),
            values: Vec::new(),
            duration_s: 3_600.0,
        }
    }
}

/// Checks that `value` is in `range`, which NaN never is.
fn check<T: PartialOrd + fmt::Display>(
    field: &'static str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<(), String> {
    if range.contains(&value) {
        return Ok(());
    }
    let (least, most) = range.into_inner();
    Err(format!(
        "{field}: must be from {least} to {most}, not {value}"
    ))
}

impl Basics {
    fn check(&self) -> Result<(), String> {
        check("baseline_s", self.baseline_s, 1.0..=LONGEST_S)?;
        check("apply_within_s", self.apply_within_s, 1.0..=LONGEST_S)?;
        check("fewest_clips", self.fewest_clips, 2..=10_000)?;
        check("confidence", self.confidence, 0.5..=0.999_999)?;
        check_why(&self.why)
    }
}

/// Checks the length of a reason.
pub(crate) fn check_why(why: &str) -> Result<(), String> {
    match why.len() {
        0..=LONGEST_WHY => Ok(()),
        _ => Err(format!("why: must have at most {LONGEST_WHY} bytes")),
    }
}

impl RolloutPlan {
    /// Checks the plan.
    ///
    /// # Errors
    /// The first invalid field.
    pub fn check(&self) -> Result<(), String> {
        check("soak_s", self.soak_s, 1.0..=LONGEST_S)?;
        check("patience_s", self.patience_s, 0.0..=LONGEST_S)?;
        check("held_for_s", self.held_for_s, 1.0..=LONGEST_S)?;
        check(
            "offline_deadline_s",
            self.offline_deadline_s,
            1.0..=LONGEST_S,
        )?;
        check("fewest_applied", self.fewest_applied, 0.01..=1.0)?;
        if !(1..=MOST).contains(&self.stages.len()) {
            return Err(format!("stages: must be from 1 to {MOST} sizes"));
        }
        self.check_stages()?;
        self.basics.check()
    }

    /// Checks the sizes of the stages, and that none shrinks: the larger one would be given the value at once.
    fn check_stages(&self) -> Result<(), String> {
        let mut sizes: Vec<StageSize> = Vec::new();
        for text in &self.stages {
            let Some(size) = StageSize::of(text) else {
                return Err(format!(
                    "stages: `{text}` is not the size of a stage; write `1`, `10%` or `all`"
                ));
            };
            if let Some(larger) = sizes.iter().position(|before| before.exceeds(size)) {
                let before = &self.stages[larger];
                return Err(format!(
                    "stages: `{text}` is fewer than `{before}` before it; each size includes the earlier stages, so \
                     sizes must grow"
                ));
            }
            sizes.push(size);
        }
        Ok(())
    }

    /// The number of `all` nodes that have the new value once each stage has begun. A stage that adds no node, as in a small
    /// fleet, is left out.
    pub fn stage_ends(&self, all: usize) -> Vec<usize> {
        let sizes = self.stages.iter().filter_map(|size| StageSize::of(size));
        let mut ends: Vec<usize> = sizes.map(|size| size.nodes(all)).collect();
        ends.dedup_by(|end, before| end <= before);
        ends
    }
}

impl TrialPlan {
    /// Checks the plan.
    pub(crate) fn check(&self) -> Result<(), String> {
        if !(2..=MOST).contains(&self.values.len()) {
            return Err(format!("values: must be from 2 to {MOST} values"));
        }
        for (i, value) in self.values.iter().enumerate() {
            if self.values[..i].contains(value) {
                return Err(format!("values: {value} is listed twice"));
            }
            if value.name != self.values[0].name {
                return Err("values: must be values of one threshold".to_owned());
            }
        }
        check("duration_s", self.duration_s, 1.0..=LONGEST_S)?;
        self.basics.check()
    }
}
