//! Judges the state of a node. docs/fleet.md describes the rules.

use crate::named::named;
use albireo_wire::HealthState;
use std::time::Duration;

named! {
    /// The state of a node.
    pub enum PresenceState {
        /// It sends status messages, and every part works.
        Online = "online",
        /// It sends status messages, and a part does not work.
        Degraded = "degraded",
        /// It sent no status for a while.
        Silent = "silent",
        /// It sent no status for long, or its liveliness token disappeared.
        Offline = "offline",
    }
}

impl PresenceState {
    /// True if it sends status messages.
    pub(crate) const fn is_heard(self) -> bool {
        matches!(self, Self::Online | Self::Degraded)
    }
}

/// The facts by which the state of a node is judged.
#[derive(Clone, Copy, Debug)]
pub struct PresenceInput<'a> {
    /// Time since the last status; `None` if none was received.
    pub heard_ago: Option<Duration>,
    /// True if its liveliness token disappeared, and no status was received since.
    pub token_gone: bool,
    /// The health in the last status.
    pub health: HealthState,
    /// The reasons for that health; may be empty until the full status arrives.
    pub reasons: &'a str,
    /// The reason to assume that several nodes use the name.
    pub identity: Option<&'a str>,
}

/// The times without a status after which a node is silent or offline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The time after which it is silent.
    pub silent: Duration,
    /// The time after which it is offline.
    pub offline: Duration,
}

/// Returns the state of a node, and the reason.
pub fn judge(facts: &PresenceInput<'_>, limits: Limits) -> (PresenceState, String) {
    let Some(ago) = facts.heard_ago else {
        let why = "no status was received yet";
        return (PresenceState::Silent, why.to_owned());
    };
    if facts.token_gone {
        let why = "its liveliness token disappeared: it stopped, or its connection broke";
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
