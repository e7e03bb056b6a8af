//! Judges the state of a node. docs/fleet.md describes the rules.

use super::entry::Entry;
use crate::config::PresenceConfig;
use crate::named::named;
use albireo_wire::HealthState;
use std::time::Duration;

named! {
    /// The state of a node.
    #[derive(Default)]
    pub enum PresenceState {
        /// It sends status messages, and every part works.
        Online = "online",
        /// It sends status messages, and a part does not work.
        Degraded = "degraded",
        /// It sent no status for a while.
        #[default]
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

/// A time limit, from its seconds.
pub(super) fn seconds(limit_s: f64) -> Duration {
    Duration::try_from_secs_f64(limit_s).unwrap_or(Duration::MAX)
}

/// Returns the state of a node whose last status is that old, and the reason. Without a status the time is `None`.
pub(super) fn judge(
    node: &Entry,
    heard_ago: Option<Duration>,
    config: &PresenceConfig,
) -> (PresenceState, String) {
    let Some(ago) = heard_ago else {
        let why = "no status was received yet";
        return (PresenceState::Silent, why.to_owned());
    };
    if node.token_gone {
        let why = "its liveliness token disappeared: it stopped, or its connection broke";
        return (PresenceState::Offline, why.to_owned());
    }
    for (state, limit_s) in [
        (PresenceState::Offline, config.offline_after_s),
        (PresenceState::Silent, config.silent_after_s),
    ] {
        if ago >= seconds(limit_s) {
            return (state, format!("no status for {limit_s} s"));
        }
    }
    if let Some((why, _)) = &node.identity {
        return (PresenceState::Degraded, why.clone());
    }
    let status = node.node.status.as_ref();
    let reasons = status.map_or_else(String::new, |status| status.health.text());
    let why = match (node.health, reasons.as_str()) {
        (HealthState::Ready, _) => return (PresenceState::Online, String::new()),
        (HealthState::Degraded, "") => "a part does not work".to_owned(),
        (HealthState::NotReady, "") => "it does not answer frames".to_owned(),
        _ => reasons,
    };
    (PresenceState::Degraded, why)
}
