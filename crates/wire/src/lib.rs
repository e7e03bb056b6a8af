//! What goes over Zenoh: key expressions and the JSON messages on them. Node, hub and clients use these
//! types and no others.
//!
//! On the local network: frames in, [`DetectionsMessage`], [`ClipReport`] and [`CountersMessage`] out, the
//! knob both ways. Between node and hub: [`ReportBatch`], the only way a report is delivered, [`StatusMessage`],
//! and what the hub desires, which a node pulls ([`PullRequest`], [`Desired`]).

mod audit;
mod clip;
mod counters;
mod desired;
mod frames;
mod keys;
mod knob;
mod report;
mod states;
mod status;
mod target;
#[cfg(test)]
mod tests;
mod version;

pub use albireo_core::audit::{AuditRate, AuditSquares, AuditSums};
pub use albireo_core::policy::{CallCause, Knob, KnobError};
pub use albireo_core::target::{KnobRange, Standing, Target, TargetError, TargetState};
pub use audit::{AuditFigures, AuditReport};
pub use clip::{
    BoardState, ClipEnd, ClipEnergy, ClipReport, DomainEnergy, EnergyQuality, FULL_COVERAGE,
    Percentiles,
};
pub use counters::{CountersMessage, DomainWatts};
pub use desired::{Desired, Poke, PullRequest};
pub use frames::{BoxMessage, DetectionsMessage, FrameAnswer, FrameAttachment, Latency};
pub use keys::{
    CameraKeys, FleetKeys, KeyError, NodeKeys, check_segment, stream_of_token, stream_token,
    stream_tokens,
};
pub use knob::{KnobChange, KnobValue, ThresholdMessage, WrongKnob};
pub use report::{
    BatchCompression, BatchError, LARGEST_BATCH_BYTES, REPORT_DICTIONARY, ReceivedBatch,
    RefusalReason, ReportAnswer, ReportBatch, ReportRefusal,
};
pub use states::{DetectorCalls, DroppedFrames, FrameStates};
pub use status::{
    CameraState, CameraStatus, HealthState, HealthStatus, KnobSource, NodeStatus, OutboxStatus,
    RefusedDesired, SignOfLife, StatusMessage, run_number,
};
pub use target::{TargetMessage, TargetReport, TargetStatus};
pub use version::{MessageError, VERSION, read};
