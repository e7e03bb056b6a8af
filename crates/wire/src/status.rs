//! The status of a node on `{prefix}/@status/{node}`: in full on a change, otherwise a heartbeat at times.

use crate::version::{MessageError, VERSION, check_version};
use crate::{EnergyQuality, NodeTarget, Threshold};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Most cameras of a node. A status with so many fits into [`LARGEST_STATUS_BYTES`].
pub const MOST_CAMERAS: usize = 128;

/// Largest [`StatusMessage`] that a hub reads, bytes: a kilobyte for each camera with the reason of its fault, and 64 for the
/// rest.
pub const LARGEST_STATUS_BYTES: usize = (MOST_CAMERAS + 64) << 10;

/// A heartbeat, with the full status if it changed or was requested. If only the number of waiting reports changed, the
/// node sends a [`Heartbeat`] instead.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StatusMessage {
    /// Version of the message.
    pub v: u32,
    /// A random number for this run of the process: it distinguishes two runs, and two nodes with the same name.
    pub run: u32,
    /// Start time of the process, nanoseconds since the Unix epoch.
    pub started_ns: u64,
    /// Number of this message within the run, from 0; after a gap the hub requests the full status.
    pub seq: u64,
    /// The node's clock, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// Health of the node.
    pub health: HealthState,
    /// Reports waiting in the outbox.
    pub waiting: u64,
    /// Revision of the desired value in force; 0 for none.
    pub revision: u64,
    /// The full status, if it changed since the last message.
    pub full: Option<Box<NodeStatus>>,
}

/// A short message, sent at intervals if only the number of waiting reports has changed since the last status:
/// about twenty bytes. On the wire it is the array `[v, run, seq, waiting]`, on the status key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// The run whose last status still applies.
    pub run: u32,
    /// Number of this message within the run; statuses and heartbeats share one sequence.
    pub seq: u64,
    /// Reports waiting in the outbox.
    pub waiting: u64,
}

impl Heartbeat {
    /// Returns the bytes to send.
    ///
    /// # Errors
    /// Never in practice: numbers can always be serialized.
    pub fn to_payload(&self) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&(VERSION, self.run, self.seq, self.waiting))
    }

    /// Reads a heartbeat.
    ///
    /// # Errors
    /// [`MessageError`] if it is not an array of four numbers or has another version.
    pub fn read(payload: &[u8]) -> Result<Self, MessageError> {
        let (found, run, seq, waiting): (u32, u32, u64, u64) = serde_json::from_slice(payload)?;
        check_version(found)?;
        Ok(Self { run, seq, waiting })
    }

    /// True if a payload on the status key is a heartbeat and not a [`StatusMessage`].
    pub fn is_one(payload: &[u8]) -> bool {
        payload.trim_ascii_start().first() == Some(&b'[')
    }
}

/// The health of a node.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum HealthState {
    /// All parts work.
    #[default]
    Ready,
    /// It answers frames, but a part has failed.
    Degraded,
    /// It does not answer frames: it is starting, or an essential part has failed.
    NotReady,
}

/// The health of a node with the reasons.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct HealthStatus {
    /// Health of the node.
    pub state: HealthState,
    /// Problems by part; empty when ready.
    pub reasons: BTreeMap<String, String>,
}

impl HealthStatus {
    /// The problems as one text; empty when ready.
    pub fn text(&self) -> String {
        let reasons: Vec<_> =
            self.reasons.iter().map(|(part, reason)| format!("{part}: {reason}")).collect();
        reasons.join("; ")
    }
}

/// The full status that a hub shows of a node between reports.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NodeStatus {
    /// Version of the program.
    pub version: String,
    /// Labels from the configuration, for selecting nodes: `region = "north"`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
    /// The node's cameras.
    pub cameras: Vec<CameraStatus>,
    /// Name of the policy, the same for all cameras.
    pub policy: String,
    /// File name of the detector model.
    pub model: String,
    /// Execution provider that actually runs the model; absent until the model is loaded.
    pub provider: Option<String>,
    /// Source of the power figures: `rapl`, `estimate`, …
    pub power_source: String,
    /// Quality of the power figures.
    pub power_quality: EnergyQuality,
    /// Health with its reasons.
    pub health: HealthStatus,
    /// The reports that wait, and those that were lost.
    pub outbox: OutboxStatus,
    /// The desired value that the node refused, until it accepts a later one; absent if it refused none.
    pub refused: Option<RefusedRevision>,
    /// The node's target; absent without a target.
    pub target: Option<NodeTarget>,
    /// Human-readable reason why a target that the node had since its start was switched off.
    pub target_off: Option<String>,
    /// The certificates with which the node identifies itself, and those it trusts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub certificates: Vec<CertificateStatus>,
}

/// How long a certificate is valid.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CertificateStatus {
    /// The key that names its file: `uplink.certificate`.
    pub name: String,
    /// Its end, seconds since the Unix epoch.
    pub until_s: i64,
}

/// A desired value that a node refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RefusedRevision {
    /// Revision of the value, greater than the one in force.
    pub revision: u64,
    /// Human-readable reason: the policy has another threshold, or the value is out of range.
    pub reason: String,
}

/// The state of a camera's frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CameraState {
    /// Frames arrive.
    Live,
    /// Frames arrived earlier, but no longer do.
    Stale,
    /// No frame has arrived since the start.
    NeverSeen,
}

/// The origin of a threshold or a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SettingSource {
    /// The configuration.
    Configuration,
    /// A user at the node, by HTTP or Zenoh.
    Local,
    /// The hub, with the revision in the status.
    Hub,
}

impl SettingSource {
    /// The word for it, as on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Configuration => "configuration",
            Self::Local => "local",
            Self::Hub => "hub",
        }
    }
}

/// One camera of a [`NodeStatus`].
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CameraStatus {
    /// Name of the camera.
    pub name: String,
    /// State of its frames.
    pub state: CameraState,
    /// Threshold in force; absent when the policy has none.
    pub threshold: Option<Threshold>,
    /// Origin of the threshold.
    pub threshold_source: SettingSource,
}

/// The outbox of a [`NodeStatus`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct OutboxStatus {
    /// Reports waiting for delivery.
    pub waiting: u64,
    /// Reports lost because the outbox was full or its disk failed.
    pub lost: u64,
    /// Reports that a hub refused permanently or that could not be read.
    #[serde(default)]
    pub undeliverable: u64,
    /// True if reports survive a power loss; false without a state directory or if its disk fails.
    pub durable: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_status_of_as_many_cameras_as_a_node_may_have_is_read_by_a_hub() {
        let camera = json!({
            "name": "c".repeat(200), "state": "never_seen", "threshold": {"name": "lambda", "value": 1.0 / 3.0},
            "threshold_source": "configuration",
        });
        let reason = format!("{}; ", "its source cannot be opened ".repeat(20));
        let status = json!({
            "version": "0.2.0", "cameras": vec![camera; MOST_CAMERAS], "policy": "expected-loss", "model": "detector.onnx",
            "power_source": "rapl", "power_quality": "measured",
            "health": {"state": "degraded", "reasons": {"cameras": reason.repeat(MOST_CAMERAS)}},
            "outbox": OutboxStatus::default(),
        });
        let status: NodeStatus = serde_json::from_value(status).unwrap();
        let message = StatusMessage {
            v: VERSION,
            run: u32::MAX,
            started_ns: u64::MAX,
            seq: u64::MAX,
            t_ns: u64::MAX,
            health: HealthState::Degraded,
            waiting: u64::MAX,
            revision: u64::MAX,
            full: Some(Box::new(status)),
        };
        let bytes = serde_json::to_vec(&message).unwrap().len();
        assert!(bytes <= LARGEST_STATUS_BYTES, "{bytes}");
    }

    #[test]
    fn a_heartbeat_is_an_array_of_four_numbers_unlike_a_status() {
        let heartbeat = Heartbeat {
            run: 509_983_003,
            seq: 33,
            waiting: 3,
        };
        let payload = heartbeat.to_payload().unwrap();
        assert_eq!(payload, b"[1,509983003,33,3]");
        assert!(Heartbeat::is_one(&payload));
        assert_eq!(Heartbeat::read(&payload).unwrap(), heartbeat);
        assert!(!Heartbeat::is_one(b"{\"v\":1}"));
        for wrong in [&b"[2,1,33,3]"[..], b"[1,1,33]", b"[1,-1,33,3]", b"[]", b"["] {
            assert!(Heartbeat::read(wrong).is_err());
        }
    }
}
