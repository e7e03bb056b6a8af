//! Says what is wrong with the connection to the hub, and for how long that is normal.

use super::schedule::Trouble;
use albireo_service::readiness::Part;
use albireo_wire::NodeKeys;
use std::time::{Duration, Instant};

/// The health of the node's part `uplink`.
pub(super) struct UplinkHealth {
    part: Part,
    /// What the part says now.
    said: Option<String>,
    /// The time since which no session serves the hub.
    lost_since: Option<Instant>,
    /// True if the node has an uplink, or has found a hub since its start.
    expects_hub: bool,
}

impl UplinkHealth {
    pub(super) fn new(part: Part, expects_hub: bool) -> Self {
        Self {
            part,
            said: None,
            lost_since: None,
            expects_hub,
        }
    }

    /// Says what is wrong, or that nothing is.
    fn say(&mut self, what: Option<String>) {
        if what == self.said {
            return;
        }
        match &what {
            Some(reason) => self.part.degraded(reason),
            None => self.part.works(),
        }
        self.said = what;
    }

    /// Says that there is no session, once that has lasted for longer than the `normal` time.
    pub(super) fn no_session(&mut self, why: &str, normal: Duration) {
        let since = *self.lost_since.get_or_insert_with(Instant::now);
        if since.elapsed() >= normal {
            self.say(Some(why.to_owned()));
        }
    }

    /// Says why reports are not acknowledged over a session.
    pub(super) fn judge(&mut self, trouble: Option<Trouble>, is_connected: bool, keys: &NodeKeys) {
        self.expects_hub |= is_connected;
        self.lost_since = None;
        let Some(trouble) = trouble else {
            return self.say(None);
        };
        if !self.expects_hub {
            return self.say(None);
        }
        let key = keys.report();
        let reason = match trouble {
            Trouble::NoHub => format!(
                "no hub answers on `{key}`, and clip reports wait: is a hub running, with the same prefix, and may this \
                 node's certificate use that key?"
            ),
            Trouble::Unanswered => format!(
                "a hub takes clip reports and does not answer: it hangs, or the router's access rules deny `{key}`"
            ),
            Trouble::Refused(why) => format!("the hub refuses clip reports: {why}"),
        };
        self.say(Some(reason));
    }
}
