//! Recordings as MCAP files: written by a node, mended after a power cut, and read, whoever wrote them.
//!
//! For a camera `front`, a file has these topics, each with its schema:
//!
//! | topic | message | encoding |
//! | --- | --- | --- |
//! | `/front/image` | `foxglove.CompressedImage` | protobuf |
//! | `/front/boxes` | `foxglove.ImageAnnotations` | protobuf |
//! | `/front/figures` | `albireo.Figures`: state, τ, threshold, objects as numbers | protobuf |
//! | `/front/detections` | the message of the camera's key `detections` | JSON |
//! | `/front/position` | `foxglove.LocationFix`, where the position is known | protobuf |
//! | `/front/event` | `albireo.Event`: why there is a recording | JSON |
//! | `/front/audit` | `albireo.Audit`: the boxes shown and those that the detector found afterwards | JSON |
//! | `/front/audit/image`, `/front/audit/boxes` | picture and boxes of such a frame | protobuf |

mod annotations;
mod file;
mod foxglove;
mod mend;
mod message;
mod picture;
mod read;
mod schema;
#[cfg(test)]
mod tests;
#[cfg(feature = "compressed")]
mod zstandard;

pub use annotations::colour;
pub use file::RecordingFile;
pub use mend::{Mended, mend};
pub use message::{AuditMessage, EventMessage, Topic};
pub use picture::{PictureKind, picture_in_json, picture_in_protobuf};
pub use read::{Channel, Message, Messages, Overview};

use mcap::McapError;
use std::path::Path;

/// The ending of the names of recordings.
pub const EXTENSION: &str = "mcap";

/// True for a path with the ending of recordings, in small or capital letters.
pub fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case(EXTENSION))
}

/// A reason why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file system refuses.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The file is not what its format asks for, or cannot be written or unpacked.
    #[error("{}", in_words(.0))]
    Mcap(McapError),
    /// A message is not what its schema says.
    #[error("{0}")]
    Message(String),
}

impl From<McapError> for RecordingError {
    fn from(error: McapError) -> Self {
        Self::Mcap(error)
    }
}

/// What went wrong. The words of [`McapError::Io`] are the same for a full disk and for damaged data.
fn in_words(error: &McapError) -> String {
    match error {
        McapError::Io(cause) => cause.to_string(),
        other => other.to_string(),
    }
}
