//! The messages of a frame: the incoming attachment and the outgoing detections.

use crate::{Position, Threshold};
use albireo_core::detection::ObjectId;
use albireo_core::policy::{BoxSource, CallCause, FrameState, PassCause};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// Metadata that a camera may add to a frame, in the attachment of its sample.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FrameAttachment {
    /// Version of the message.
    pub v: u32,
    /// Sequence number, incremented per frame. Without it, frames are numbered by arrival.
    pub seq: Option<u64>,
    /// Stream that `seq` belongs to: a sender that restarts uses another number, such as its start time in nanoseconds,
    /// and so loses no frame.
    pub stream: Option<u64>,
    /// Capture time, nanoseconds since the Unix epoch. Without it, the sample's timestamp is used.
    pub t_ns: Option<u64>,
    /// Clip that the frame belongs to. Without it, clips are fixed time windows.
    pub clip: Option<String>,
    /// Width of a raw picture, pixels.
    pub width: Option<u32>,
    /// Height of a raw picture, pixels.
    pub height: Option<u32>,
    /// Where the frame was taken. A position that cannot be read is counted and left out, and the frame is processed.
    // Any JSON: a position of another form must not cost the frame.
    #[schema(value_type = Option<Position>)]
    pub position: Option<serde_json::Value>,
}

impl FrameAttachment {
    /// Where the frame was taken; `None` if the attachment does not say it.
    ///
    /// # Errors
    /// The reason why it is no position.
    pub fn position(&self) -> Option<Result<Position, String>> {
        self.position.as_ref().map(read_position)
    }
}

fn read_position(given: &serde_json::Value) -> Result<Position, String> {
    let position = Position::deserialize(given).map_err(|error| error.to_string())?;
    position.check()?;
    Ok(position)
}

/// The node's answer to a frame received as a query, sent when the frame's turn comes: the sender of a camera with
/// `delivery = "every"` then sends its next frame. If a query ends without an answer, the frame was not accepted.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FrameAnswer {
    /// Version of the message.
    pub v: u32,
    /// The reason why the frame will not be processed; absent if it will be.
    pub refused: Option<String>,
}

/// One box of a [`DetectionsMessage`].
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BoxMessage {
    /// Left, top, right, bottom in pixels of the source picture, clipped to it.
    #[serde(rename = "box")]
    pub corners: [f32; 4],
    /// Name of the class.
    pub class: String,
    /// Confidence, 0 to 1.
    pub confidence: f32,
    /// How the policy knows of the box.
    pub source: BoxSource,
    /// Object that the box belongs to.
    pub object: Option<ObjectId>,
    /// True if the object is confirmed.
    pub confirmed: bool,
}

/// Duration of each step of one frame, milliseconds. A step that did not happen is absent.
#[skip_serializing_none]
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Latency {
    /// From reception to the answer, excluding JSON serialization, publication and time in Zenoh.
    pub total: f64,
    /// Wait in the ring for the camera's loop.
    pub waiting: f64,
    /// Picture decoding.
    pub decode: Option<f64>,
    /// The empty-scene screen, including its preprocessing.
    pub screen: Option<f64>,
    /// The detector: queue, letterbox, model and head.
    pub detector: Option<f64>,
    /// The policy itself.
    pub policy: f64,
}

/// The state and boxes of one frame.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DetectionsMessage {
    /// Version of the message.
    pub v: u32,
    /// Sequence number of the frame.
    pub seq: u64,
    /// Capture time, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// Clip that the frame belongs to.
    pub clip: String,
    /// Frame state; `P` while the frame is pending.
    pub state: FrameState,
    /// True if the boxes are immediate predictions. Final state and boxes follow on the camera's `late` key.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub pending: bool,
    /// True if the detector was needed but not available; the boxes are predictions.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub degraded: bool,
    /// The reason for the detector call, also if the detector was not available; absent if the frame did not need it.
    pub cause: Option<CallCause>,
    /// The reason why a pause passed over the frame; absent if none did.
    pub passed: Option<PassCause>,
    /// Largest uncertainty τ before the decision; absent without objects.
    pub tau_max: Option<f64>,
    /// Threshold in force; absent if the policy has none.
    pub threshold: Option<Threshold>,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// The boxes in view.
    pub boxes: Vec<BoxMessage>,
    /// Duration of each step.
    pub latency_ms: Latency,
}

impl DetectionsMessage {
    /// True if the frame needed no detector. A degraded frame needed it, although its state is `P`, too.
    pub const fn skipped_detector(&self) -> bool {
        self.state.is_skipped() && !self.degraded
    }
}

/// The boxes of one frame for recordings, interpolated between two detector calls if the second came in time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SettledMessage {
    /// Version of the message.
    pub v: u32,
    /// Sequence number of the frame.
    pub seq: u64,
    /// Capture time, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// Clip that the frame belongs to.
    pub clip: String,
    /// The frame's final state.
    pub state: FrameState,
    /// False if the boxes are those of the original answer because no later detector call came in time.
    pub settled: bool,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// The boxes in view.
    pub boxes: Vec<BoxMessage>,
}
