//! Settings of incoming frames: limits for all, format and delivery per camera.

use serde::{Deserialize, Serialize};

/// Limits that are checked before memory is taken for a frame: the `[frame]` section.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameLimits {
    /// Largest payload, bytes.
    pub max_payload_bytes: usize,
    /// Most columns of a picture.
    pub max_width: u32,
    /// Most rows of a picture.
    pub max_height: u32,
    /// Largest decoded picture, bytes.
    pub max_decoded_bytes: usize,
}

impl Default for FrameLimits {
    fn default() -> Self {
        Self {
            max_payload_bytes: 16 << 20,
            max_width: 7680,
            max_height: 4320,
            max_decoded_bytes: 128 << 20,
        }
    }
}

/// How the payload of a camera's samples is to be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PayloadFormat {
    /// By the sample's Zenoh `Encoding`: `image/jpeg`, `image/png`, `image/raw;rgb8` (`bgr8`, `gray8`,
    /// `nv12`; size in the attachment). Without an encoding the first bytes decide between JPEG and PNG.
    #[default]
    Encoding,
    /// ROS 2 `sensor_msgs/msg/CompressedImage` in CDR.
    Ros2CompressedImage,
    /// ROS 2 `sensor_msgs/msg/Image` in CDR.
    Ros2Image,
}

/// Which frames a camera's loop gets to see when they come faster than it works.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Delivery {
    /// The newest; older ones are dropped and counted as overrun.
    #[default]
    Newest,
    /// Every one: each frame comes as a query, answered when its turn has come, which holds the sender back; and the
    /// detections wait for slow subscribers. For replays.
    Every,
}
