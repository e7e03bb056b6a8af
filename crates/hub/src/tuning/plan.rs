//! The plans of rollouts and trials.

use super::gate::Gate;
use super::selector::Selector;
use crate::named::as_text;
use albireo_wire::Threshold;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;
use utoipa::ToSchema;

const DAY_S: f64 = 86_400.0;
/// Longest of the times in a plan, seconds.
const LONGEST_S: f64 = 90.0 * DAY_S;
/// Most stages, and most values of a trial.
const MOST: usize = 20;
/// Longest reason, bytes.
const LONGEST_WHY: usize = 500;

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

impl FromStr for StageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let size = match text.strip_suffix('%') {
            None if text == "all" => Some(Self::Share(1.0)),
            None => text
                .parse()
                .ok()
                .filter(|nodes| *nodes > 0)
                .map(Self::Nodes),
            Some(percent) => {
                // As many digits as are written of it.
                let percent = percent.trim().parse::<f64>().ok();
                let percent = percent.map(|percent| (percent * 1e4).round() / 1e4);
                (percent.filter(|percent| *percent > 0.0 && *percent <= 100.0))
                    .map(|percent| Self::Share(percent / 100.0))
            }
        };
        size.ok_or_else(|| {
            format!("stages: `{text}` is no size of a stage; write `1`, `10%` or `all`")
        })
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnFailure {
    /// Every node of the rollout gets its old value back.
    #[default]
    Return,
    /// Nothing changes until a person decides, or the plan's `held_for_s` is over.
    Hold,
}

/// What the plans of rollouts and trials have in common.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct Basics {
    /// Which nodes.
    #[schema(value_type = Vec<String>)]
    pub select: Selector,
    /// How far back the measurements before the change go, seconds.
    pub baseline_s: f64,
    /// How long a node in reach may take to report the value, seconds.
    pub apply_within_s: f64,
    /// Fewest clips of a node before and after; those with fewer are left out.
    pub fewest_clips: u64,
    /// How sure verdicts are. With 0.95, at most one of twenty rollouts without any effect is judged failed, all gates, stages
    /// and looks together, and at most one of twenty changes beyond a bound passes its stage. Of a trial it is the probability
    /// that all intervals hold the truth together.
    pub confidence: f64,
    /// Draws the order of the nodes, or the groups; chosen by the hub when it is not given.
    pub seed: Option<u64>,
    /// Why.
    pub why: String,
}

impl Default for Basics {
    fn default() -> Self {
        Self {
            select: Selector::default(),
            // Nodes vary from hour to hour; a week covers that.
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
    /// What a trial has too.
    #[serde(flatten)]
    pub basics: Basics,
    /// How many nodes have the new value in each stage, all stages before included. Where the last leaves some out, they keep
    /// the old value, and the last stage is measured against them.
    #[schema(value_type = Vec<String>)]
    pub stages: Vec<StageSize>,
    /// How long a stage is held before its gates are judged, seconds.
    pub soak_s: f64,
    /// How much longer a stage is held when its gates could not be judged at the end of the soak, seconds.
    pub patience_s: f64,
    /// What the change may cost.
    #[schema(value_type = Vec<String>)]
    pub gates: Vec<Gate>,
    /// What happens when a gate fails.
    pub on_failure: OnFailure,
    /// How long the rollout is held for a person to decide before the old value returns, seconds.
    pub held_for_s: f64,
    /// Share of a stage's nodes in reach that must have reported the value; with fewer the stage has failed.
    pub fewest_applied: f64,
    /// How long a node out of reach may stay away, seconds; then its value is withdrawn and it is named.
    pub offline_deadline_s: f64,
}

impl Default for RolloutPlan {
    fn default() -> Self {
        use StageSize::{Nodes, Share};
        Self {
            basics: Basics::default(),
            stages: vec![Nodes(1), Share(0.1), Share(0.5), Share(1.0)],
            // A day has enough different hours to see a change.
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
    /// What a rollout has too.
    #[serde(flatten)]
    pub basics: Basics,
    /// The values, two or more of one threshold; each is compared with the first.
    pub values: Vec<Threshold>,
    /// How long the values hold once the nodes have reported them, seconds.
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

/// Whether `value` lies in `range`; written so that NaN does not.
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

/// Whether a reason can be kept.
pub(crate) fn check_why(why: &str) -> Result<(), String> {
    match why.len() {
        0..=LONGEST_WHY => Ok(()),
        _ => Err(format!("why: must have at most {LONGEST_WHY} bytes")),
    }
}

impl RolloutPlan {
    /// Whether it can be followed.
    ///
    /// # Errors
    /// The first field that makes no sense.
    pub fn check(&self) -> Result<(), String> {
        check("soak_s", self.soak_s, 1.0..=LONGEST_S)?;
        check("patience_s", self.patience_s, 0.0..=LONGEST_S)?;
        check("held_for_s", self.held_for_s, 1.0..=LONGEST_S)?;
        let deadline = self.offline_deadline_s;
        check("offline_deadline_s", deadline, 1.0..=LONGEST_S)?;
        check("fewest_applied", self.fewest_applied, 0.01..=1.0)?;
        if !(1..=MOST).contains(&self.stages.len()) {
            return Err(format!("stages: must be from 1 to {MOST} sizes"));
        }
        self.basics.check()
    }

    /// How many of `all` nodes have the new value once each stage has begun. A stage that has none new, in a small fleet, is left
    /// out.
    pub fn stage_ends(&self, all: usize) -> Vec<usize> {
        let mut ends: Vec<usize> = Vec::new();
        for end in self.stages.iter().map(|size| size.of(all)) {
            if ends.last().is_none_or(|last| *last < end) {
                ends.push(end);
            }
        }
        ends
    }
}

impl TrialPlan {
    /// Whether it can be followed.
    pub(crate) fn check(&self) -> Result<(), String> {
        if !(2..=MOST).contains(&self.values.len()) {
            return Err(format!("values: must be from 2 to {MOST} values"));
        }
        for (i, value) in self.values.iter().enumerate() {
            if self.values[..i].contains(value) {
                return Err(format!("values: {value} is named twice"));
            }
            if value.name != self.values[0].name {
                return Err("values: must be values of one threshold".to_owned());
            }
        }
        check("duration_s", self.duration_s, 1.0..=LONGEST_S)?;
        self.basics.check()
    }
}
