//! A camera's threshold on its Zenoh key.

use crate::api::key_service::KeyValue;
use crate::state::board::{CameraBoard, set_thresholds};
use albireo_wire::{MessageError, SettingSource, ThresholdMessage, VERSION};
use std::sync::Arc;

/// One camera's threshold.
pub(crate) struct ThresholdKey(pub Arc<CameraBoard>);

impl KeyValue for ThresholdKey {
    fn what(&self) -> &'static str {
        "threshold"
    }

    fn change(&self, payload: &[u8]) -> Result<Vec<u8>, String> {
        // `v` may be left out here, as in a hand-typed put, so the versioned reader does not fit.
        let message: ThresholdMessage = serde_json::from_slice(payload).map_err(|error| {
            format!(r#"expected {{"threshold":{{"name":"u","value":3e-4}}}} as JSON: {error}"#)
        })?;
        if message.v != VERSION {
            return Err(MessageError::Version { found: message.v }.to_string());
        }
        let camera = std::slice::from_ref(&self.0);
        set_thresholds(camera, message.threshold, SettingSource::Local)
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
