//! The status of a node, `{prefix}/@status/{node}`: in full when something changed, otherwise a heartbeat every 30 seconds.

use crate::version::{MessageError, VERSION, check_version};
use crate::{EnergyQuality, NodeTarget, Threshold};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// A heartbeat with the full status when it changed or was requested. If only the number of waiting reports has changed,
/// the node sends a [`Heartbeat`] instead.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StatusMessage {
    /// Version.
    pub v: u32,
    /// A random number of this run of the process: it distinguishes two runs, and two nodes with the same name.
    pub run: u32,
    /// When the process started, nanoseconds since the Unix epoch.
    pub started_ns: u64,
    /// Number of this message within the run, from 0; a gap makes the hub ask for the full status.
    pub seq: u64,
    /// The node's clock, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// Whether it works as it should.
    pub health: HealthState,
    /// Reports that wait in the outbox.
    pub waiting: u64,
    /// Revision of the desired value that is in force; 0 when none is.
    pub revision: u64,
    /// The full status, if something in it changed since the last message.
    pub full: Option<Box<NodeStatus>>,
}

/// A short message, sent twice per minute if only the number of waiting reports has changed since the last status: about
/// twenty bytes. On the wire it is the array `[v, run, seq, waiting]`, on the key of the status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// The run whose last status still holds.
    pub run: u32,
    /// Number of this message within the run; statuses and heartbeats are counted together.
    pub seq: u64,
    /// Reports that wait in the outbox.
    pub waiting: u64,
}

impl Heartbeat {
    /// The bytes that are sent.
    ///
    /// # Errors
    /// None that can happen: numbers can always be written.
    pub fn to_payload(&self) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&(VERSION, self.run, self.seq, self.waiting))
    }

    /// Reads one.
    ///
    /// # Errors
    /// [`MessageError`] when it is not an array of four numbers, or of another version.
    pub fn read(payload: &[u8]) -> Result<Self, MessageError> {
        let (found, run, seq, waiting): (u32, u32, u64, u64) = serde_json::from_slice(payload)?;
        check_version(found)?;
        Ok(Self { run, seq, waiting })
    }

    /// Whether a payload on the key of the status is one of these and not a [`StatusMessage`].
    pub fn is_one(payload: &[u8]) -> bool {
        payload.trim_ascii_start().first() == Some(&b'[')
    }
}

/// Whether a node works as it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum HealthState {
    /// Every part works.
    Ready,
    /// It answers frames, but a part does not work.
    Degraded,
    /// It does not answer frames: it starts, or a part it cannot do without has failed.
    NotReady,
}

/// Health with its reasons.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct HealthStatus {
    /// Whether it works as it should.
    pub state: HealthState,
    /// What is wrong, by part; empty when ready.
    pub reasons: BTreeMap<String, String>,
}

/// Everything a hub shows of a node between reports.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NodeStatus {
    /// Version of the program.
    pub version: String,
    /// Labels of its configuration, for selecting nodes: `region = "north"`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
    /// Cameras.
    pub cameras: Vec<CameraStatus>,
    /// Policy.
    pub policy: String,
    /// Detector model: file name.
    pub model: String,
    /// Execution provider that really runs it; absent until the model is loaded.
    pub provider: Option<String>,
    /// Where power figures come from: `rapl`, `estimate`, …
    pub power_source: String,
    /// How far they can be trusted.
    pub power_quality: EnergyQuality,
    /// Health with its reasons.
    pub health: HealthStatus,
    /// The outbox.
    pub outbox: OutboxStatus,
    /// The desired value that the node did not take, until it takes a later one; absent when it refused none.
    pub refused: Option<RefusedDesired>,
    /// Its target; absent without a target.
    pub target: Option<NodeTarget>,
    /// Why it has no target any more, in words, if it had one since its start.
    pub target_off: Option<String>,
}

/// A desired value that a node did not take.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RefusedDesired {
    /// Its revision: greater than the one in force.
    pub revision: u64,
    /// Why, in words: the policy has another threshold, or the value is outside of its range.
    pub reason: String,
}

/// Whether frames come from a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CameraState {
    /// Frames arrive.
    Live,
    /// Frames arrived, but no longer do.
    Stale,
    /// No frame has arrived since the start.
    NeverSeen,
}

/// Who set a threshold or a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SettingSource {
    /// The configuration.
    Configuration,
    /// Somebody at the node, by HTTP or Zenoh.
    Local,
    /// The hub, with the revision of the status.
    Hub,
}

/// One camera of a [`NodeStatus`].
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CameraStatus {
    /// Its name.
    pub name: String,
    /// Whether frames come.
    pub state: CameraState,
    /// Threshold in force; absent when the policy has none.
    pub threshold: Option<Threshold>,
    /// Who set it.
    pub threshold_source: SettingSource,
}

/// The outbox of a [`NodeStatus`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct OutboxStatus {
    /// Reports that wait.
    pub waiting: u64,
    /// Reports lost: the outbox was full or its disk broken.
    pub lost: u64,
    /// Reports that the hub refused for good.
    #[serde(default)]
    pub undeliverable: u64,
    /// Whether reports survive a power loss; `false` without a state directory or when its disk fails.
    pub durable: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heartbeat_is_an_array_of_four_numbers_and_no_status() {
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
