//! Follows the nodes of a rollout or trial: the orders to each, and the outcomes.

use crate::named::named;
use crate::presence::NodeView;
use crate::store::row::json_text;
use albireo_wire::{DesiredSetting, Threshold};
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Milliseconds since the Unix epoch, by the hub's clock.
pub(crate) type Millis = i64;

named! {
    /// The outcome of an order at a node.
    pub enum Outcome {
        /// It got no order.
        Untouched = "untouched",
        /// It got the order and has not answered yet.
        Pending = "pending",
        /// It is out of reach; it gets the setting when it returns.
        Waiting = "waiting",
        /// It reported the setting.
        Applied = "applied",
        /// It refused the setting.
        Refused = "refused",
        /// It is in reach and did not report the setting in time; it still may.
        TimedOut = "timed_out",
        /// It was forgotten, or stayed out of reach until a rollout's deadline; the order was withdrawn.
        Missed = "missed",
        /// A newer order replaced this one before it answered.
        Superseded = "superseded",
        /// It has the setting already.
        Unchanged = "unchanged",
        /// It would get the order without `dry_run`.
        WouldChange = "would_change",
    }
}

impl Outcome {
    /// True while the node may still report the setting by itself.
    pub(crate) const fn is_open(self) -> bool {
        matches!(self, Self::Pending | Self::Waiting | Self::TimedOut)
    }
}

/// An order to one node, and its outcome.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Ask {
    /// Its revision.
    pub revision: u64,
    /// When the node was asked; for a node that was out of reach, when it returned.
    pub asked_ms: Millis,
    /// The outcome.
    pub outcome: Outcome,
    /// When the hub learned the outcome, milliseconds since the Unix epoch.
    pub at_ms: Millis,
    /// The reason for the outcome; empty without one.
    pub detail: String,
}

impl Ask {
    /// Creates an order that was given at `asked_ms`, with that revision.
    pub(crate) const fn new(revision: u64, asked_ms: Millis, outcome: Outcome) -> Self {
        Self {
            revision,
            asked_ms,
            outcome,
            at_ms: asked_ms,
            detail: String::new(),
        }
    }

    /// Updates the outcome of an order for `wanted` from the node's state. Returns true if it changed.
    pub(crate) fn observe(
        &mut self,
        node: &NodeView,
        wanted: DesiredSetting,
        patience_ms: Millis,
        now: Millis,
    ) -> bool {
        if !self.outcome.is_open() {
            return false;
        }
        // A node whose policy has no targets accepts the revision and ignores the target.
        let unable = match wanted {
            DesiredSetting::Target(Some(_)) if node.is_reachable() => node.unable(wanted),
            _ => None,
        };
        let refused = node
            .status
            .as_ref()
            .and_then(|status| status.refused.as_ref())
            .filter(|refused| refused.revision == self.revision);
        let next = if node.revision >= self.revision && node.has(wanted) {
            Outcome::Applied
        } else if let Some(reason) = unable.or_else(|| Some(refused?.reason.clone())) {
            self.detail = reason;
            Outcome::Refused
        } else if !node.is_reachable() {
            Outcome::Waiting
        } else if self.outcome == Outcome::Waiting {
            self.asked_ms = now;
            Outcome::Pending
        } else if self.outcome == Outcome::Pending && now - self.asked_ms < patience_ms {
            Outcome::Pending
        } else {
            Outcome::TimedOut
        };
        let is_new = std::mem::replace(&mut self.outcome, next) != next;
        if is_new {
            self.at_ms = now;
        }
        is_new
    }
}

/// The outcome of a change at one node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ChangeNode {
    /// The node.
    pub node: String,
    /// Its setting before, if known: a threshold or a target.
    #[serde(deserialize_with = "json_text::deserialize")]
    pub from: Option<DesiredSetting>,
    /// The order.
    #[serde(flatten)]
    pub ask: Ask,
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
    /// The value of the last order: first its new one, then its old one; absent if it got none.
    pub asked: Option<Threshold>,
    /// The last order.
    #[serde(flatten)]
    pub ask: Ask,
    /// True if it was in reach when the run was stored.
    pub reachable: bool,
    /// True if it was in reach when the present stage began.
    pub was_reachable: bool,
}

impl Member {
    /// Creates a member that gets no order.
    pub(crate) const fn new(node: String, before: Threshold, reachable: bool) -> Self {
        Self {
            node,
            group: 0,
            before,
            asked: None,
            ask: Ask::new(0, 0, Outcome::Untouched),
            reachable,
            was_reachable: false,
        }
    }

    /// When it reported the value, if it did.
    pub(crate) fn applied_ms(&self) -> Option<Millis> {
        (self.ask.outcome == Outcome::Applied).then_some(self.ask.at_ms)
    }
}

/// Shuffles a list by the algorithm of Fisher and Yates, seeded with `seed`.
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

    fn new() -> Threshold {
        Threshold::new("u", 5e-4)
    }

    fn old() -> Threshold {
        Threshold::new("u", 3e-4)
    }

    /// An order for the new value, of revision 7.
    fn order() -> Ask {
        Ask::new(7, 0, Outcome::Pending)
    }

    fn observe(order: &mut Ask, node: &NodeView, now: Millis) -> &'static str {
        order.observe(node, DesiredSetting::Threshold(new()), 100, now);
        order.outcome.name()
    }

    #[test]
    fn a_change_is_applied_once_the_node_reports_it() {
        let no = None;
        for (what, node, at, expected) in [
            ("nothing yet", reported(true, 6, old(), no), 10, "pending"),
            ("the value", reported(true, 7, new(), no), 10, "applied"),
            ("a later one", reported(true, 8, new(), no), 10, "applied"),
            ("another value", reported(true, 7, old(), no), 10, "pending"),
            ("too early", reported(true, 6, new(), no), 10, "pending"),
            ("too late", reported(true, 6, old(), no), 100, "timed_out"),
            ("away", reported(false, 6, old(), no), 100, "waiting"),
            ("left since", reported(false, 7, new(), no), 100, "applied"),
            ("refused", reported(true, 6, old(), Some(7)), 10, "refused"),
            ("an older", reported(true, 6, old(), Some(6)), 10, "pending"),
        ] {
            assert_eq!(observe(&mut order(), &node, at), expected, "{what}");
        }
    }

    #[test]
    fn a_node_that_was_offline_has_its_full_time_after_its_return() {
        let mut order = order();
        for (reachable, at, expected) in [
            (false, 50, "waiting"),
            (true, 5_000, "pending"),
            (true, 5_099, "pending"),
            (true, 5_100, "timed_out"),
        ] {
            let node = reported(reachable, 6, old(), None);
            assert_eq!(observe(&mut order, &node, at), expected, "{at}");
        }
        let node = reported(true, 7, new(), None);
        assert_eq!(observe(&mut order, &node, 9_000), "applied");
        assert_eq!(order.at_ms, 9_000);
    }
}
