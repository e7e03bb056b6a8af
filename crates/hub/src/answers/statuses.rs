//! Receives the nodes' status messages, heartbeats and liveliness tokens.

use super::Answers;
use crate::HubError;
use crate::store::row::beginning;
use albireo_service::clock::Now;
use albireo_service::rate_limit::RateLimit;
use albireo_wire::{Heartbeat, LARGEST_STATUS_BYTES, NodeKeys, StatusMessage};
use std::sync::Arc;
use std::time::Duration;
use zenoh::Session;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

/// Any node can send what cannot be read as often as it likes.
static UNREADABLE: RateLimit = RateLimit::new(Duration::from_secs(10));

impl Answers {
    /// Receives the statuses and heartbeats of the nodes with these keys until the returned declaration is dropped.
    pub(crate) async fn hear_statuses(
        &self,
        keys: &NodeKeys,
        session: &Session,
    ) -> Result<Subscriber<()>, HubError> {
        let answers = self.clone();
        session
            .declare_subscriber(keys.status())
            .callback(move |sample| answers.hear(sample.key_expr().as_str(), sample.payload()))
            .await
            .map_err(HubError::at("status messages cannot be subscribed to"))
    }

    /// Receives the liveliness tokens of the nodes with these keys until the returned declaration is dropped.
    pub(crate) async fn hear_tokens(
        &self,
        keys: &NodeKeys,
        session: &Session,
    ) -> Result<Subscriber<()>, HubError> {
        let fleet = Arc::clone(&self.fleet);
        session
            .liveliness()
            .declare_subscriber(keys.alive())
            .history(true)
            .callback(move |sample| {
                if let Some(node) = NodeKeys::node_of(sample.key_expr().as_str()) {
                    fleet.token(node, sample.kind() == SampleKind::Put);
                }
            })
            .await
            .map_err(HubError::at("liveliness tokens cannot be watched"))
    }

    /// Reads a message and applies it. Returns true if the node's full status is missing.
    fn apply(&self, node: &str, message: &[u8], now: Now) -> Result<bool, String> {
        if message.len() > LARGEST_STATUS_BYTES {
            let bytes = message.len();
            return Err(format!(
                "it has {bytes} bytes, more than {LARGEST_STATUS_BYTES}"
            ));
        }
        if Heartbeat::is_one(message) {
            let heartbeat = Heartbeat::read(message).map_err(|error| error.to_string())?;
            return Ok(self.fleet.alive(node, heartbeat, now));
        }
        let status: StatusMessage =
            albireo_wire::read(message).map_err(|error| error.to_string())?;
        Ok(self.fleet.apply_status(node, status, now))
    }

    /// Applies the status or heartbeat that came on a key, and notifies its node if its full status is missing.
    fn hear(&self, key: &str, payload: &ZBytes) {
        let node = match NodeKeys::sender_of(key) {
            Ok(node) => node,
            Err(error) => return self.unreadable(key, &error.to_string()),
        };
        match self.apply(node, &payload.to_bytes(), Now::system()) {
            Ok(is_full_due) => {
                self.counters.count(|counts| counts.statuses += 1);
                if is_full_due {
                    self.desired.notify(node);
                }
            }
            Err(error) => self.unreadable(key, &error),
        }
    }

    /// Counts a status that is not applied, and logs from where it came and why.
    fn unreadable(&self, key: &str, reason: &str) {
        self.counters.count(|counts| counts.statuses_unreadable += 1);
        UNREADABLE.log(|held_back| {
            let key = beginning(key);
            let reason = beginning(reason);
            tracing::warn!(held_back, key, reason, "a status cannot be read");
        });
    }
}
