//! The Zenoh protocol: key expressions and the JSON messages on them. Nodes, hubs and clients use only these types.
//!
//! On the local network: frames in; [`DetectionsMessage`], [`ClipReport`] and [`CountersMessage`] out; the threshold
//! both ways. Between node and hub: [`ReportBatch`], the only way to deliver reports, [`StatusMessage`], and the
//! desired settings that a node pulls from the hub ([`RevisionMessage`], [`Desired`]).

mod audit;
mod boxes;
mod clip;
mod counters;
mod desired;
mod frames;
mod keys;
mod policy;
mod report;
mod screen;
mod sighting;
mod states;
mod status;
mod target;
#[cfg(test)]
mod tests;
mod threshold;
mod travel;
mod version;

pub use albireo_core::audit::{AuditRate, AuditSquares, AuditSums};
pub use albireo_core::policy::{CallCause, ThresholdSpec};
pub use albireo_core::target::{Target, TargetStatus};
pub use audit::{AuditFigures, AuditReport};
pub use boxes::box_messages;
pub use clip::{
    BoardState, ClipEnd, ClipEnergy, ClipReport, DomainEnergy, EnergyQuality, FULL_COVERAGE,
    Percentiles, significant,
};
pub use counters::{CountersMessage, DomainWatts};
pub use desired::{Desired, DesiredSetting, RevisionMessage};
pub use frames::{
    BoxMessage, DetectionsMessage, FrameAnswer, FrameAttachment, Latency, SettledMessage,
};
pub use keys::{
    CameraKeys, KeyError, NodeKeys, check_camera_name, check_node_name, check_segment,
    stream_of_token, stream_token,
};
pub use policy::{PolicyChoice, PolicyMessage};
pub use report::{
    BatchCompression, IDENTITY_DAYS, LARGEST_BATCH_BYTES, LARGEST_REPORT_BYTES, MOST_REPORTS,
    REPORT_DICTIONARY, RefusalReason, RefusedReport, ReportAge, ReportAnswer, ReportBatch,
    ReportRefusal, decompress_batch,
};
pub use screen::{Pauses, ScreenMessage};
pub use sighting::{Sighting, SightingEvent};
pub use states::{DetectorCalls, DropKind, DroppedFrames, FrameStates};
pub use status::{
    CameraState, CameraStatus, CertificateStatus, HealthState, HealthStatus, Heartbeat,
    LARGEST_STATUS_BYTES, MOST_CAMERAS, NodeStatus, OutboxStatus, RefusedRevision, SettingSource,
    StatusMessage,
};
pub use target::{NodeTarget, TargetMessage, TargetReport};
pub use threshold::{OtherThreshold, Threshold, ThresholdChange, ThresholdMessage, ThresholdName};
pub use travel::{ClipTravel, FASTEST_M_S, MOST_TRACK_POINTS, Position};
pub use version::{MessageError, VERSION, check_version, read};
