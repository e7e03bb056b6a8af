//! A camera's threshold on its Zenoh key.

use crate::api::key_service::KeyValue;
use crate::state::board::CameraBoard;
use albireo_wire::{MessageError, SettingSource, ThresholdMessage, VERSION};
use std::sync::Arc;

/// One camera's threshold.
pub(crate) struct ThresholdKey(pub Arc<CameraBoard>);

impl KeyValue for ThresholdKey {
    fn what(&self) -> &'static str {
        "threshold"
    }

    fn change(&self, payload: &[u8]) -> Result<Vec<u8>, String> {
        let board = &self.0;
        // `v` may be left out here, as in a hand-typed put, so the versioned reader does not fit.
        let message: ThresholdMessage = serde_json::from_slice(payload).map_err(|error| {
            format!(r#"expected {{"threshold":{{"name":"u","value":3e-4}}}} as JSON: {error}"#)
        })?;
        if message.v != VERSION {
            return Err(MessageError::Version { found: message.v }.to_string());
        }
        if let Some(knob) = board.knob() {
            (message.threshold.value_of(&knob)).map_err(|error| error.to_string())?;
        }
        (board.set_threshold(message.threshold.value, SettingSource::Local))
            .map_err(|error| error.to_string())?;
        self.in_force()
    }

    fn in_force(&self) -> Result<Vec<u8>, String> {
        let threshold = (self.0.threshold_in_force())
            .ok_or_else(|| "the policy in use has no threshold".to_owned())?;
        serde_json::to_vec(&ThresholdMessage {
            v: VERSION,
            threshold,
        })
        .map_err(|error| error.to_string())
    }
}
