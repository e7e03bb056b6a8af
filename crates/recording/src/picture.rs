//! Recognises channels of pictures, and reads those of Foxglove.

use crate::RecordingError;
use crate::foxglove::CompressedImage;
use crate::read::Channel;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use bytes::Bytes;
use prost::Message;
use serde::Deserialize;
use std::fmt::Display;

/// How the pictures of a channel are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureKind {
    /// `foxglove.CompressedImage` in protobuf.
    FoxgloveProtobuf,
    /// The same in JSON, with the picture in base64.
    FoxgloveJson,
    /// ROS 2 `sensor_msgs/msg/CompressedImage` or `Image` in CDR.
    Ros2,
}

impl PictureKind {
    /// The kind of a channel's pictures; `None` if it holds something else.
    pub fn of(channel: &Channel) -> Option<Self> {
        match (channel.schema.as_str(), channel.encoding.as_str()) {
            ("foxglove.CompressedImage", "protobuf") => Some(Self::FoxgloveProtobuf),
            ("foxglove.CompressedImage", "json") => Some(Self::FoxgloveJson),
            ("sensor_msgs/msg/CompressedImage" | "sensor_msgs/msg/Image", "cdr") => {
                Some(Self::Ros2)
            }
            _ => None,
        }
    }
}

/// The picture file in a `foxglove.CompressedImage` in protobuf.
///
/// # Errors
/// If the message is not one.
pub fn picture_in_protobuf(message: &Bytes) -> Result<Bytes, RecordingError> {
    let image = CompressedImage::decode(message.clone()).map_err(no_image)?;
    Ok(image.data)
}

/// The picture file in a `foxglove.CompressedImage` in JSON, where it is in base64.
///
/// # Errors
/// If the message is not one.
pub fn picture_in_json(message: &Bytes) -> Result<Bytes, RecordingError> {
    #[derive(Deserialize)]
    struct InJson {
        data: String,
    }
    let image: InJson = serde_json::from_slice(message).map_err(no_image)?;
    let file = BASE64_STANDARD.decode(image.data).map_err(no_image)?;
    Ok(file.into())
}

fn no_image(error: impl Display) -> RecordingError {
    RecordingError::Message(format!("no CompressedImage: {error}"))
}
