//! The message that a class has appeared in a camera's picture, or has left it.

use crate::version::current_version;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What became of a class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SightingEvent {
    /// It is in the picture, and was not before.
    Appeared,
    /// It is not in the picture any more.
    Left,
}

/// A class appeared in a camera's picture, or left it: the body of a hook's POST, and of the MQTT topic `…/event`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Sighting {
    /// Version of the message.
    #[serde(default = "current_version")]
    pub v: u32,
    /// Name of the node.
    pub node: String,
    /// Name of the camera.
    pub camera: String,
    /// Name of the class.
    pub class: String,
    /// What became of it.
    pub event: SightingEvent,
    /// Sequence number of the frame that decided it.
    pub seq: u64,
    /// The frame's time, nanoseconds since the Unix epoch, as in its detections message.
    pub t_ns: u64,
    /// Time of the first frame with the class, if it appeared, or of the last, if it left: `t_ns` is later by the time
    /// for which it had to be there, or away.
    pub since_ns: u64,
    /// Boxes of the class in the frame that decided it.
    pub count: u32,
    /// The highest confidence among them; absent if it left.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confidence: Option<f32>,
    /// If it left: seconds from its first to its last frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}
