//! The state of a node as a function of what is known. Pure: docs/fleet.md has the same predicates in words.

use crate::named::named;
use albireo_wire::HealthState;
use std::time::Duration;

named! {
    /// How a node is.
    pub enum PresenceState {
        /// It is heard, and everything works.
        Online = "online",
        /// It is heard, and something does not work.
        Degraded = "degraded",
        /// It was not heard for a while.
        Silent = "silent",
        /// It is gone.
        Offline = "offline",
    }
}

impl PresenceState {
    /// Whether it is heard.
    pub(crate) const fn is_heard(self) -> bool {
        matches!(self, Self::Online | Self::Degraded)
    }
}

/// What is known of a node.
#[derive(Clone, Copy, Debug)]
pub struct PresenceInput<'a> {
    /// Since the last status; `None` when none ever came.
    pub heard_ago: Option<Duration>,
    /// Whether its liveliness token went, and nothing was heard since.
    pub token_gone: bool,
    /// What the last status says.
    pub health: HealthState,
    /// Its reasons, in words; may be empty while the full status is on its way.
    pub reasons: &'a str,
    /// Why the name or the instance is not one node's alone.
    pub identity: Option<&'a str>,
}

/// From when on a node counts as silent and as offline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Silent after.
    pub silent: Duration,
    /// Offline after.
    pub offline: Duration,
}

/// The state, and why.
pub fn judge(facts: &PresenceInput<'_>, limits: Limits) -> (PresenceState, String) {
    let Some(ago) = facts.heard_ago else {
        return (PresenceState::Silent, "no status has come yet".to_owned());
    };
    if facts.token_gone {
        let why = "its liveliness token went: it stopped, or its link broke";
        return (PresenceState::Offline, why.to_owned());
    }
    let quiet = |limit: Duration| format!("no status for {} s", limit.as_secs_f64());
    if ago >= limits.offline {
        return (PresenceState::Offline, quiet(limits.offline));
    }
    if ago >= limits.silent {
        return (PresenceState::Silent, quiet(limits.silent));
    }
    if let Some(identity) = facts.identity {
        return (PresenceState::Degraded, identity.to_owned());
    }
    let why = match (facts.health, facts.reasons) {
        (HealthState::Ready, _) => return (PresenceState::Online, String::new()),
        (HealthState::Degraded, "") => "a part does not work",
        (HealthState::NotReady, "") => "it does not answer frames",
        (_, reasons) => reasons,
    };
    (PresenceState::Degraded, why.to_owned())
}
