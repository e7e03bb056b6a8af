//! Receives the nodes' status messages, heartbeats and liveliness tokens.

use super::Answers;
use crate::HubError;
use albireo_service::clock::Now;
use albireo_wire::{Heartbeat, NodeKeys, StatusMessage};
use std::sync::Arc;
use zenoh::Session;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

/// Largest status, bytes: twice the size of a status with as many cameras as a node may have.
const LARGEST_STATUS: usize = 64 << 10;

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
            .callback(move |sample| {
                if let Some(node) = NodeKeys::node_of(sample.key_expr().as_str()) {
                    answers.hear(node, sample.payload());
                }
            })
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
        if message.len() > LARGEST_STATUS {
            return Err(format!("it has {} bytes", message.len()));
        }
        if Heartbeat::is_one(message) {
            let heartbeat = Heartbeat::read(message).map_err(|error| error.to_string())?;
            return Ok(self.fleet.alive(node, heartbeat, now));
        }
        let status: StatusMessage =
            albireo_wire::read(message).map_err(|error| error.to_string())?;
        Ok(self.fleet.apply_status(node, status, now))
    }

    /// Applies the status or heartbeat of a node, and notifies the node if its full status is missing.
    fn hear(&self, node: &str, payload: &ZBytes) {
        let now = Now::system();
        match self.apply(node, &payload.to_bytes(), now) {
            Ok(is_full_due) => {
                self.counters.count(|counts| counts.statuses += 1);
                if is_full_due {
                    self.desired.notify(node);
                }
            }
            Err(error) => {
                self.counters.count(|counts| counts.statuses_unreadable += 1);
                tracing::debug!(node, error, "a status cannot be read");
            }
        }
    }
}
