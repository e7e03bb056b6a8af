//! The node's target on its Zenoh key.

use crate::api::key_service::KeyValue;
use crate::state::board::Board;
use albireo_wire::{MessageError, SettingSource, TargetMessage, VERSION};
use std::sync::Arc;

/// A node's target.
pub(crate) struct TargetKey(pub Arc<Board>);

impl KeyValue for TargetKey {
    fn what(&self) -> &'static str {
        "target"
    }

    fn change(&self, payload: &[u8]) -> Result<Vec<u8>, String> {
        let message: TargetMessage = serde_json::from_slice(payload).map_err(|error| {
            format!("expected JSON such as {{\"target\":{{\"skip_rate\":0.5}}}}: {error}")
        })?;
        if message.v != VERSION {
            return Err(MessageError::Version { found: message.v }.to_string());
        }
        (self.0.set_target(message.target, SettingSource::Local))
            .map_err(|error| error.to_string())?;
        self.in_force()
    }

    fn in_force(&self) -> Result<Vec<u8>, String> {
        serde_json::to_vec(&self.0.target().report()).map_err(|error| error.to_string())
    }
}
