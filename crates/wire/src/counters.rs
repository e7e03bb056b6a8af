//! The counters of a camera, sent once per second.

use crate::{
    AuditFigures, DetectorCalls, DroppedFrames, EnergyQuality, FrameStates, TargetReport, Threshold,
};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// The counters of a camera, sent once per second.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CountersMessage {
    /// Version of the message.
    pub v: u32,
    /// Time of these counts, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// Name of the camera.
    pub camera: String,
    /// Frames processed since the node started.
    pub frames: u64,
    /// Frame states since the node started.
    pub states: FrameStates,
    /// Share of frames that skipped the detector since the node started: state E or P and not degraded.
    pub skip_rate: f64,
    /// Frames answered by prediction because the detector was not available: state P, not counted as skipped.
    pub degraded_frames: u64,
    /// Frames that called the detector since the node started, by cause, including degraded ones.
    #[serde(default, skip_serializing_if = "DetectorCalls::is_empty")]
    #[schema(value_type = std::collections::BTreeMap<String, u64>)]
    pub calls: DetectorCalls,
    /// Frames not processed, by kind.
    pub dropped: DroppedFrames,
    /// Threshold in force; absent if the policy has none.
    pub threshold: Option<Threshold>,
    /// Current power by domain, watts; empty without a source.
    pub watts: Vec<DomainWatts>,
    /// Quality of the watts.
    pub power_quality: EnergyQuality,
    /// The target of the node; absent without a target.
    pub target: Option<TargetReport>,
    /// The results of the audit since the node started, or since the policy was switched; absent without an audit.
    pub audit: Option<AuditFigures>,
}

/// The current power of one domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DomainWatts {
    /// `total`, `gpu`, `cpu`, `io_mem`.
    pub domain: String,
    /// Power of the newest sample, watts.
    pub watts: f64,
}
