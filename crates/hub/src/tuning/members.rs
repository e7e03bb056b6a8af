//! The nodes of a rollout or a trial: what each is to have, and what it answered.

use crate::presence::NodeSettings;
use crate::setting::is_applied;
use albireo_wire::DesiredSetting;
use albireo_wire::Threshold;
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use utoipa::ToSchema;

/// Milliseconds since the Unix epoch, by the hub's clock.
pub type Millis = i64;

/// What a node is to have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
// In descriptions `Target` is what a node holds.
#[schema(as = MemberTarget)]
pub enum Target {
    /// What it has.
    #[default]
    Untouched,
    /// The value of its stage or group.
    New,
    /// Its value before.
    Old,
}

/// Where a node is with its target.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "outcome", rename_all = "snake_case")]
pub enum Outcome {
    /// Nothing was asked of it.
    #[default]
    Untouched,
    /// Asked; it has not answered yet.
    Pending,
    /// It is out of reach; it will find the value when it returns.
    Waiting,
    /// It reported the value.
    Applied {
        /// When the hub heard it.
        at_ms: Millis,
    },
    /// It reported that it does not take the value.
    Refused {
        /// Why.
        reason: String,
    },
    /// It is in reach and did not report the value in time; it may still.
    TimedOut,
    /// It stayed out of reach until the deadline; the value was withdrawn.
    Missed,
}

impl Outcome {
    /// Whether the node answered what became of the value, or is known to be unable to.
    pub(crate) const fn is_decided(&self) -> bool {
        !matches!(self, Self::Pending)
    }

    /// What follows from what is `seen` of a node that was asked, at `asked_ms`, for `wanted` with that revision. A node that was
    /// away has its time again from its return.
    pub(crate) fn next(
        &self,
        observed: &Observation,
        wanted: DesiredSetting,
        revision: u64,
        asked_ms: &mut Millis,
        patience_ms: Millis,
        now: Millis,
    ) -> Self {
        use Outcome::{Applied, Missed, Pending, Refused, TimedOut, Untouched, Waiting};
        let has_it =
            observed.revision >= revision && is_applied(wanted, observed.knob, observed.target);
        // A program without targets takes the revision and ignores the target.
        let unable = (observed.cannot_hold.as_ref())
            .filter(|_| observed.reachable && matches!(wanted, DesiredSetting::Target(Some(_))));
        let refused = (observed.refused.as_ref())
            .filter(|(refused, _)| *refused == revision)
            .map(|(_, reason)| reason);
        match (self, unable.or(refused)) {
            (Applied { .. } | Untouched | Missed, _) => self.clone(),
            _ if has_it => Applied { at_ms: now },
            (_, Some(reason)) => Refused {
                reason: reason.clone(),
            },
            (Refused { .. }, _) => self.clone(),
            _ if !observed.reachable => Waiting,
            (TimedOut, _) => TimedOut,
            (Waiting, _) => {
                *asked_ms = now;
                Pending
            }
            _ if now - *asked_ms >= patience_ms => TimedOut,
            _ => Pending,
        }
    }

    /// Whether its time runs: the node was asked and has not answered.
    pub(crate) const fn is_open(&self) -> bool {
        matches!(self, Self::Pending | Self::Waiting)
    }

    /// When it was applied.
    pub(crate) const fn applied_at(&self) -> Option<Millis> {
        match self {
            Self::Applied { at_ms } => Some(*at_ms),
            _ => None,
        }
    }

    /// Why, where there is something to say.
    pub(crate) fn detail(&self) -> String {
        match self {
            Self::Refused { reason } => reason.clone(),
            _ => String::new(),
        }
    }

    /// Its name in messages and tables.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Untouched => "untouched",
            Self::Pending => "pending",
            Self::Waiting => "waiting",
            Self::Applied { .. } => "applied",
            Self::Refused { .. } => "refused",
            Self::TimedOut => "timed_out",
            Self::Missed => "missed",
        }
    }
}

/// What the hub knows of a node at a moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Whether it is in reach.
    pub reachable: bool,
    /// Revision in force that it reported last.
    pub revision: u64,
    /// Value in force on all of its cameras that it reported last; `None` when they differ or have none.
    pub knob: Option<Threshold>,
    /// The target that it holds.
    pub target: Option<albireo_wire::Target>,
    /// Why it cannot hold any target, as far as it reported.
    pub cannot_hold: Option<String>,
    /// The desired value it reported last as refused: revision and reason.
    pub refused: Option<(u64, String)>,
}

impl From<&NodeSettings> for Observation {
    fn from(node: &NodeSettings) -> Self {
        Self {
            reachable: node.reachable,
            revision: node.revision,
            knob: node.threshold(),
            target: node.target(),
            cannot_hold: node.cannot_hold(),
            refused: node.refused(),
        }
    }
}

/// One node of a rollout or trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Member {
    /// Its name.
    pub node: String,
    /// Its stage or group, from 0.
    pub group: usize,
    /// Its value at the beginning.
    pub before: Threshold,
    /// What it is to have.
    pub target: Target,
    /// The target that it was last asked for.
    pub asked: Target,
    /// Revision of that.
    pub revision: u64,
    /// When it was asked.
    pub asked_ms: Millis,
    /// What it said.
    #[serde(flatten)]
    pub outcome: Outcome,
    /// Whether it is in reach.
    #[serde(default)]
    pub reachable: bool,
    /// Whether it was in reach when the stage that is measured began.
    #[serde(default)]
    pub was_reachable: bool,
}

impl Member {
    /// A node that nothing is asked of.
    pub fn new(node: impl Into<String>, group: usize, before: Threshold) -> Self {
        Self {
            node: node.into(),
            group,
            before,
            target: Target::Untouched,
            asked: Target::Untouched,
            revision: 0,
            asked_ms: 0,
            outcome: Outcome::Untouched,
            reachable: false,
            was_reachable: false,
        }
    }

    /// Sets what it is to have. One that was never asked for anything has nothing to go back from.
    pub(crate) fn aim(&mut self, target: Target) {
        self.target = match (target, self.asked) {
            (Target::Old, Target::Untouched) => Target::Untouched,
            _ => target,
        };
    }

    /// It is to have its value before again.
    pub(crate) fn give_back(&mut self) {
        self.aim(Target::Old);
        if self.asked == Target::Untouched {
            self.outcome = Outcome::Untouched;
        }
    }

    /// Whether it has to be asked.
    pub(crate) fn is_due(&self) -> bool {
        self.target != self.asked && self.target != Target::Untouched
    }

    /// Notes that it was asked for its target.
    pub fn asked(&mut self, revision: u64, now: Millis) {
        self.asked = self.target;
        self.revision = revision;
        self.asked_ms = now;
        // A node whose value was withdrawn stays named as one that missed it.
        if !(self.outcome == Outcome::Missed && self.target == Target::Old) {
            self.outcome = Outcome::Pending;
        }
    }

    /// Takes in what is known of the node. `new` is the value of its group. Returns whether the outcome changed.
    pub(crate) fn observe(
        &mut self,
        observed: &Observation,
        new: Threshold,
        patience_ms: Millis,
        now: Millis,
    ) -> bool {
        if matches!(self.outcome, Outcome::Untouched | Outcome::Missed) || self.is_due() {
            return false;
        }
        let wanted = if self.asked == Target::Old {
            self.before
        } else {
            new
        };
        let next = self.outcome.next(
            observed,
            wanted.into(),
            self.revision,
            &mut self.asked_ms,
            patience_ms,
            now,
        );
        let changed = next != self.outcome;
        self.outcome = next;
        changed
    }
}

/// The order of `0..count` that `seed` gives: Fisher and Yates.
pub(crate) fn shuffled(count: usize, seed: u64) -> Vec<usize> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut order: Vec<usize> = (0..count).collect();
    for i in (1..count).rev() {
        // The multiplication spreads 64 random bits over 0..=i; its bias is below 2^-40 for any fleet.
        let pick = (u128::from(random.next_u64()) * (i as u128 + 1)) >> 64;
        order.swap(i, pick as usize);
    }
    order
}

/// Nodes to ask for a value.
#[derive(Clone, Debug, PartialEq)]
pub struct Order {
    /// The value.
    pub knob: Threshold,
    /// The nodes.
    pub nodes: Vec<String>,
    /// Whether it is the old value that returns.
    pub is_return: bool,
}

/// The members that have to be asked, by value; `new` gives the new value of a member.
pub(crate) fn due(members: &[Member], new: impl Fn(&Member) -> Threshold) -> Vec<Order> {
    let mut orders: Vec<Order> = Vec::new();
    for member in members.iter().filter(|member| member.is_due()) {
        let is_return = member.target == Target::Old;
        let knob = if is_return {
            member.before
        } else {
            new(member)
        };
        match orders
            .iter_mut()
            .find(|order| order.knob == knob && order.is_return == is_return)
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
pub(crate) fn asked(members: &mut [Member], order: &Order, revision: u64, now: Millis) {
    let nodes: HashSet<&str> = order.nodes.iter().map(String::as_str).collect();
    for member in members {
        if member.is_due() && nodes.contains(member.node.as_str()) {
            member.asked(revision, now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn new() -> Threshold {
        u(5e-4)
    }

    fn old() -> Threshold {
        u(3e-4)
    }

    fn u(value: f64) -> Threshold {
        Threshold::new("u", value)
    }

    fn observed(reachable: bool, revision: u64, knob: Threshold) -> Observation {
        Observation {
            reachable,
            revision,
            knob: Some(knob),
            target: None,
            cannot_hold: None,
            refused: None,
        }
    }

    fn asked() -> Member {
        let mut member = Member::new("n", 0, old());
        member.aim(Target::New);
        assert!(member.is_due());
        member.asked(7, 0);
        member
    }

    #[test]
    fn applied_is_what_the_node_reports() {
        let refused = |revision| Observation {
            refused: Some((revision, "range".to_owned())),
            ..observed(true, 6, old())
        };
        for (what, observed, at, expected) in [
            ("nothing yet", observed(true, 6, old()), 10, "pending"),
            ("the value", observed(true, 7, new()), 10, "applied"),
            (
                "a later revision's same value",
                observed(true, 8, new()),
                10,
                "applied",
            ),
            (
                "its revision, but another value",
                observed(true, 7, old()),
                10,
                "pending",
            ),
            (
                "the value by accident, before it was asked",
                observed(true, 6, new()),
                10,
                "pending",
            ),
            (
                "no answer in time",
                observed(true, 6, old()),
                100,
                "timed_out",
            ),
            ("away", observed(false, 6, old()), 100, "waiting"),
            (
                "applied and away since",
                observed(false, 7, new()),
                100,
                "applied",
            ),
            ("refused", refused(7), 10, "refused"),
            ("an earlier one refused", refused(6), 10, "pending"),
        ] {
            let mut member = asked();
            member.observe(&observed, new(), 100, at);
            assert_eq!(member.outcome.name(), expected, "{what}");
        }
    }

    #[test]
    fn a_node_that_was_away_has_its_full_time_after_its_return() {
        let mut member = asked();
        for (reachable, at, expected) in [
            (false, 50, "waiting"),
            (true, 5_000, "pending"),
            (true, 5_099, "pending"),
            (true, 5_100, "timed_out"),
        ] {
            member.observe(&observed(reachable, 6, old()), new(), 100, at);
            assert_eq!(member.outcome.name(), expected, "{at}");
        }
        member.observe(&observed(true, 7, new()), new(), 100, 9_000);
        assert_eq!(member.outcome, Outcome::Applied { at_ms: 9_000 });
    }

    #[test]
    fn one_that_was_never_asked_has_nothing_to_go_back_from() {
        let mut member = Member::new("n", 0, old());
        member.aim(Target::Old);
        assert!(!member.is_due());
        let mut member = asked();
        member.aim(Target::Old);
        assert!(member.is_due());
        member.asked(9, 1);
        member.observe(&observed(true, 9, old()), new(), 100, 2);
        assert_eq!(member.outcome, Outcome::Applied { at_ms: 2 });
    }

    proptest! {
        #[test]
        fn a_shuffle_has_everybody_once_and_is_the_same_for_the_same_seed(count in 0usize..200, seed in any::<u64>()) {
            let order = shuffled(count, seed);
            prop_assert_eq!(&order, &shuffled(count, seed));
            let mut sorted = order;
            sorted.sort_unstable();
            prop_assert_eq!(sorted, (0..count).collect::<Vec<_>>());
        }
    }
}
