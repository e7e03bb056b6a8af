//! Receives what cameras send: reads and numbers frames, keeps them in a ring, and opens cameras.

mod arrivals;
mod attachment;
mod counter;
mod read;
pub(crate) mod receiver;
mod ring;
mod sequence;
pub mod source;
mod topic;

pub use arrivals::ArrivalCounts;
pub use counter::{InputCounter, Unusable};
pub use read::{Frame, RawSample, read_frame};
pub(crate) use ring::{Pushed, Ring};
pub use sequence::FrameNumber;
pub(crate) use topic::{check_topic, keys_of_topic};

use serde::{Deserialize, Serialize};

/// The format of the payload of a camera's samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PayloadFormat {
    /// From the sample's Zenoh `Encoding`: `image/jpeg`, `image/png`, `image/raw;rgb8` (`bgr8`, `gray8`,
    /// `nv12`; size in the attachment). Without an encoding, the first bytes distinguish JPEG and PNG.
    #[default]
    Encoding,
    /// ROS 2 `sensor_msgs/msg/CompressedImage` or `Image` in CDR.
    #[serde(alias = "ros2_compressed_image", alias = "ros2_image")]
    Ros2,
}

/// The frames that a camera's loop sees when they arrive faster than it works.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Delivery {
    /// The newest; older ones are dropped and counted as overrun.
    #[default]
    Newest,
    /// Every frame: each comes as a query that is answered when its turn comes, which holds the sender back, and the
    /// detections wait for slow subscribers. For replays.
    Every,
}
