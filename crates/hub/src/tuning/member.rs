//! Follows what nodes were asked for: what each is to have, and what became of it.

use crate::named::named;
use crate::presence::NodeSettings;
use albireo_wire::{DesiredSetting, Threshold};
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Milliseconds since the Unix epoch, by the hub's clock.
pub(crate) type Millis = i64;

named! {
    /// What became of a setting at a node.
    pub enum Outcome {
        /// Nothing was asked of it.
        Untouched = "untouched",
        /// Asked; it has not answered yet.
        Pending = "pending",
        /// It is out of reach; it will find the setting when it returns.
        Waiting = "waiting",
        /// It reported the setting.
        Applied = "applied",
        /// It reported that it does not take the setting.
        Refused = "refused",
        /// It is in reach and did not report the setting in time; it may still.
        TimedOut = "timed_out",
        /// It was forgotten, or stayed out of reach until a rollout's deadline; the setting was withdrawn.
        Missed = "missed",
        /// Something newer was asked of it before it answered.
        Superseded = "superseded",
        /// It has the setting already.
        Unchanged = "unchanged",
        /// It would be asked, if this were no dry run.
        WouldChange = "would_change",
    }
}

/// How many nodes have which outcome.
pub(crate) type Counts = BTreeMap<Outcome, usize>;

/// Counts nodes by their outcome; those that nothing was asked of are left out.
pub(crate) fn counts(outcomes: impl IntoIterator<Item = Outcome>) -> Counts {
    let mut counts = Counts::new();
    for outcome in outcomes {
        if outcome != Outcome::Untouched {
            *counts.entry(outcome).or_default() += 1;
        }
    }
    counts
}

/// What is known of a setting that a node was asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Ask {
    /// Its revision.
    pub revision: u64,
    /// When the node was asked; one that was away has its time again from its return.
    pub asked_ms: Millis,
    /// What became of it.
    pub outcome: Outcome,
    /// When the hub heard that it is applied; 0 before.
    pub at_ms: Millis,
    /// Why the node refuses it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

impl Ask {
    /// Asked at that time, with that revision.
    pub(crate) const fn new(revision: u64, asked_ms: Millis, outcome: Outcome) -> Self {
        Self {
            revision,
            asked_ms,
            outcome,
            at_ms: 0,
            reason: String::new(),
        }
    }

    /// Takes in what is known of the node that was asked for `wanted`. Returns whether the outcome changed.
    pub(crate) fn observe(
        &mut self,
        node: &NodeSettings,
        wanted: DesiredSetting,
        patience_ms: Millis,
        now: Millis,
    ) -> bool {
        use Outcome::{Applied, Pending, Refused, TimedOut, Waiting};
        if !matches!(self.outcome, Pending | Waiting | TimedOut | Refused) {
            return false;
        }
        let has_it = node.revision >= self.revision && node.has(wanted);
        // A program without targets takes the revision and ignores the target.
        let unable = match wanted {
            DesiredSetting::Target(Some(_)) if node.reachable => node.cannot_hold(),
            _ => None,
        };
        let refused = node
            .refused()
            .filter(|(revision, _)| *revision == self.revision);
        let next = match (self.outcome, unable.or(refused.map(|(_, reason)| reason))) {
            _ if has_it => {
                self.at_ms = now;
                Applied
            }
            (_, Some(reason)) => {
                self.reason = reason;
                Refused
            }
            (Refused, None) => Refused,
            _ if !node.reachable => Waiting,
            (Waiting, None) => {
                self.asked_ms = now;
                Pending
            }
            (Pending, None) if now - self.asked_ms < patience_ms => Pending,
            _ => TimedOut,
        };
        std::mem::replace(&mut self.outcome, next) != next
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
    /// What it is to have; absent where nothing is asked of it.
    pub wanted: Option<Threshold>,
    /// What it was asked for last.
    pub asked: Option<Threshold>,
    /// What became of that.
    #[serde(flatten)]
    pub ask: Ask,
    /// Whether it is in reach.
    pub reachable: bool,
    /// Whether it was in reach when the stage that is measured began.
    pub was_reachable: bool,
}

impl Member {
    /// A node that nothing is asked of.
    pub(crate) const fn new(node: String, before: Threshold, reachable: bool) -> Self {
        Self {
            node,
            group: 0,
            before,
            wanted: None,
            asked: None,
            ask: Ask::new(0, 0, Outcome::Untouched),
            reachable,
            was_reachable: false,
        }
    }

    /// It is to have that value.
    pub(crate) fn want(&mut self, value: Threshold) {
        self.wanted = Some(value);
        // Open until it is asked, so that nothing is over before it has begun.
        self.ask.outcome = Outcome::Pending;
    }

    /// It is to have its value before again. One that was never asked for anything has nothing to go back from.
    pub(crate) fn give_back(&mut self) {
        if self.asked.is_some() {
            self.wanted = Some(self.before);
        } else {
            self.leave();
        }
    }

    /// Nothing is asked of it any more.
    pub(crate) fn leave(&mut self) {
        (self.wanted, self.asked) = (None, None);
        self.ask.outcome = Outcome::Untouched;
    }

    /// What it has to be asked for, and whether that is its old value.
    pub(crate) fn due(&self) -> Option<(Threshold, bool)> {
        let wanted = self.wanted.filter(|_| self.wanted != self.asked)?;
        Some((wanted, self.asked.is_some() && wanted == self.before))
    }

    /// Notes that it was asked for what it is to have.
    pub(crate) fn asked(&mut self, revision: u64, now: Millis) {
        self.asked = self.wanted;
        // A node whose value was withdrawn stays named as one that missed it.
        let outcome = match self.ask.outcome {
            Outcome::Missed => Outcome::Missed,
            _ => Outcome::Pending,
        };
        self.ask = Ask::new(revision, now, outcome);
    }

    /// Takes in what is known of the node. Returns whether the outcome changed.
    pub(crate) fn observe(
        &mut self,
        node: &NodeSettings,
        patience_ms: Millis,
        now: Millis,
    ) -> bool {
        self.reachable = node.reachable;
        match self.asked {
            Some(asked) if self.due().is_none() => {
                (self.ask).observe(node, asked.into(), patience_ms, now)
            }
            _ => false,
        }
    }

    /// When it reported the value that it was asked for.
    pub(crate) fn applied_ms(&self) -> Option<Millis> {
        (self.ask.outcome == Outcome::Applied).then_some(self.ask.at_ms)
    }

    /// Whether it was asked for everything and answered, or is out of reach.
    pub(crate) fn is_settled(&self) -> bool {
        self.due().is_none() && self.ask.outcome != Outcome::Pending
    }
}

/// Nodes to ask for a value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Order {
    /// The value.
    pub(crate) knob: Threshold,
    /// Whether it is the old value that returns.
    pub(crate) is_return: bool,
    /// The nodes.
    pub(crate) nodes: Vec<String>,
}

/// The members that have to be asked, by value.
pub(crate) fn due(members: &[Member]) -> Vec<Order> {
    let mut orders: Vec<Order> = Vec::new();
    for member in members {
        let Some(due) = member.due() else { continue };
        let node = member.node.clone();
        match (orders.iter_mut()).find(|order| (order.knob, order.is_return) == due) {
            Some(order) => order.nodes.push(node),
            None => orders.push(Order {
                knob: due.0,
                is_return: due.1,
                nodes: vec![node],
            }),
        }
    }
    orders
}

/// Shuffles a list as `seed` says: Fisher and Yates.
pub(crate) fn shuffle<T>(list: &mut [T], seed: u64) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    for i in (1..list.len()).rev() {
        // The multiplication spreads 64 random bits over 0..=i; its bias is below 2^-40 for any fleet.
        let pick = (u128::from(random.next_u64()) * (i as u128 + 1)) >> 64;
        list.swap(i, pick as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presence::reported;
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

    fn asked() -> Member {
        let mut member = Member::new("n".to_owned(), old(), true);
        member.want(new());
        assert!(member.due().is_some());
        member.asked(7, 0);
        member
    }

    #[test]
    fn applied_is_what_the_node_reports() {
        let no = None;
        for (what, node, at, expected) in [
            ("nothing yet", reported(true, 6, old(), no), 10, "pending"),
            ("the value", reported(true, 7, new(), no), 10, "applied"),
            (
                "a later one's same value",
                reported(true, 8, new(), no),
                10,
                "applied",
            ),
            ("another value", reported(true, 7, old(), no), 10, "pending"),
            (
                "by accident, too early",
                reported(true, 6, new(), no),
                10,
                "pending",
            ),
            (
                "no answer in time",
                reported(true, 6, old(), no),
                100,
                "timed_out",
            ),
            ("away", reported(false, 6, old(), no), 100, "waiting"),
            (
                "applied and away",
                reported(false, 7, new(), no),
                100,
                "applied",
            ),
            ("refused", reported(true, 6, old(), Some(7)), 10, "refused"),
            (
                "another one refused",
                reported(true, 6, old(), Some(6)),
                10,
                "pending",
            ),
        ] {
            let mut member = asked();
            member.observe(&node, 100, at);
            assert_eq!(member.ask.outcome.name(), expected, "{what}");
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
            member.observe(&reported(reachable, 6, old(), None), 100, at);
            assert_eq!(member.ask.outcome.name(), expected, "{at}");
        }
        member.observe(&reported(true, 7, new(), None), 100, 9_000);
        assert_eq!(member.applied_ms(), Some(9_000));
    }

    #[test]
    fn one_that_was_never_asked_has_nothing_to_go_back_from() {
        let mut member = Member::new("n".to_owned(), old(), true);
        member.give_back();
        assert!(member.due().is_none());
        let mut member = asked();
        member.give_back();
        assert_eq!(member.due(), Some((old(), true)));
        member.asked(9, 1);
        member.observe(&reported(true, 9, old(), None), 100, 2);
        assert_eq!(member.applied_ms(), Some(2));
    }

    proptest! {
        #[test]
        fn a_shuffle_has_everybody_once_and_is_the_same_for_the_same_seed(count in 0usize..200, seed in any::<u64>()) {
            let shuffled = || {
                let mut list: Vec<usize> = (0..count).collect();
                shuffle(&mut list, seed);
                list
            };
            let mut list = shuffled();
            prop_assert_eq!(&list, &shuffled());
            list.sort_unstable();
            prop_assert_eq!(list, (0..count).collect::<Vec<_>>());
        }
    }
}
