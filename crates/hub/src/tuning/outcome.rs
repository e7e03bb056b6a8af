//! What became of a desired setting at a node.

use super::member::Millis;
use crate::named::named;
use crate::presence::NodeView;
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

named! {
    /// The outcome of a desired setting at a node.
    pub enum Outcome {
        /// It was given none.
        Untouched = "untouched",
        /// It was given the setting and has not answered yet.
        Pending = "pending",
        /// It is out of reach; it gets the setting when it returns.
        Waiting = "waiting",
        /// It reported the setting.
        Applied = "applied",
        /// It refused the setting.
        Refused = "refused",
        /// It is in reach and did not report the setting in time; it still may.
        TimedOut = "timed_out",
        /// It was forgotten, or stayed out of reach until a rollout's deadline; the setting was withdrawn.
        Missed = "missed",
        /// A newer revision replaced this one before it answered.
        Superseded = "superseded",
        /// It has the setting already.
        Unchanged = "unchanged",
        /// It would be given the setting without `dry_run`.
        WouldChange = "would_change",
    }
}

impl Outcome {
    /// True while the node may still report the setting by itself.
    pub(crate) const fn is_open(self) -> bool {
        matches!(self, Self::Pending | Self::Waiting | Self::TimedOut)
    }
}

/// A desired setting that was given to a node: its revision, and what became of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Given {
    /// Its revision.
    pub revision: u64,
    /// When it was given; for a node that was out of reach, when that returned.
    pub given_ms: Millis,
    /// The outcome.
    pub outcome: Outcome,
    /// When the hub learned the outcome, milliseconds since the Unix epoch.
    pub at_ms: Millis,
    /// The reason for the outcome; empty without one.
    pub detail: String,
}

impl Given {
    /// Creates one that was given at `given_ms`, with that revision.
    pub(crate) const fn new(revision: u64, given_ms: Millis, outcome: Outcome) -> Self {
        Self {
            revision,
            given_ms,
            outcome,
            at_ms: given_ms,
            detail: String::new(),
        }
    }

    /// Updates the outcome of `setting` from the node's state. Returns true if it changed.
    pub(crate) fn observe(
        &mut self,
        node: &NodeView,
        setting: DesiredSetting,
        patience_ms: Millis,
        now: Millis,
    ) -> bool {
        if !self.outcome.is_open() {
            return false;
        }
        // A node whose policy has no targets accepts the revision and ignores the target.
        let unable = match setting {
            DesiredSetting::Target(Some(_)) if node.is_reachable() => node.unable(setting),
            _ => None,
        };
        let refused = match node.status.as_ref().and_then(|status| status.refused.as_ref()) {
            Some(refused) if refused.revision == self.revision => Some(refused.reason.clone()),
            _ => None,
        };
        let next = if node.revision >= self.revision && node.has(setting) {
            Outcome::Applied
        } else if let Some(reason) = unable.or(refused) {
            self.detail = reason;
            Outcome::Refused
        } else if !node.is_reachable() {
            Outcome::Waiting
        } else if self.outcome == Outcome::Waiting {
            self.given_ms = now;
            Outcome::Pending
        } else if self.outcome == Outcome::Pending && now - self.given_ms < patience_ms {
            Outcome::Pending
        } else {
            Outcome::TimedOut
        };
        if self.outcome == next {
            return false;
        }
        self.outcome = next;
        self.at_ms = now;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presence::reported;
    use albireo_wire::Threshold;

    fn new() -> Threshold {
        Threshold::new("u", 5e-4)
    }

    fn old() -> Threshold {
        Threshold::new("u", 3e-4)
    }

    /// The new value, given as revision 7.
    fn new_value() -> Given {
        Given::new(7, 0, Outcome::Pending)
    }

    fn observe(given: &mut Given, node: &NodeView, now: Millis) -> &'static str {
        given.observe(node, DesiredSetting::Threshold(new()), 100, now);
        given.outcome.name()
    }

    #[test]
    fn a_setting_is_applied_once_the_node_reports_it() {
        let none = reported(6, old());
        let value = reported(7, new());
        for (what, node, at, expected) in [
            ("nothing yet", none.clone(), 10, "pending"),
            ("too late", none.clone(), 100, "timed_out"),
            ("away", none.clone().silent(), 100, "waiting"),
            ("refused", none.clone().refusing(7), 10, "refused"),
            ("refused an older", none.refusing(6), 10, "pending"),
            ("the value", value.clone(), 10, "applied"),
            ("left since", value.silent(), 100, "applied"),
            ("a later revision", reported(8, new()), 10, "applied"),
            ("another value", reported(7, old()), 10, "pending"),
            ("the value by itself", reported(6, new()), 10, "pending"),
        ] {
            assert_eq!(observe(&mut new_value(), &node, at), expected, "{what}");
        }
    }

    #[test]
    fn a_node_that_was_offline_has_its_full_time_after_its_return() {
        let mut given = new_value();
        let online = reported(6, old());
        let silent = online.clone().silent();
        for (node, at, expected) in [
            (&silent, 50, "waiting"),
            (&online, 5_000, "pending"),
            (&online, 5_099, "pending"),
            (&online, 5_100, "timed_out"),
        ] {
            assert_eq!(observe(&mut given, node, at), expected, "{at}");
        }
        let node = reported(7, new());
        assert_eq!(observe(&mut given, &node, 9_000), "applied");
        assert_eq!(given.at_ms, 9_000);
    }
}
