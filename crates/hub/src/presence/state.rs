//! Judges the state of a node. docs/fleet.md has the same rules in words.

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

/// What is known of a node.
#[derive(Clone, Copy, Debug)]
pub struct PresenceInput<'a> {
    /// Time since the last status; `None` if none ever came.
    pub heard_ago: Option<Duration>,
    /// True if its liveliness token disappeared, and no status came since.
    pub token_gone: bool,
    /// The health in the last status.
    pub health: HealthState,
    /// The reasons for that health, in words; may be empty while the full status is on its way.
    pub reasons: &'a str,
    /// Why several nodes seem to use the name.
    pub identity: Option<&'a str>,
}

/// The time without a status after which a node is silent or offline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Silent after.
    pub silent: Duration,
    /// Offline after.
    pub offline: Duration,
}

/// The state of a node, and why.
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
