//! From a Zenoh sample to a frame, still encoded.

use super::{EncodedPicture, FrameFault, FrameLimits, PayloadFormat};
use bytes::Bytes;
use std::sync::Arc;
use tokio::time::Instant;

/// A sample of a frame key, as Zenoh delivers it.
#[derive(Clone, Debug)]
pub struct RawSample<'a> {
    /// The payload.
    pub payload: Bytes,
    /// The sample's Zenoh encoding as text, for example `image/jpeg`; empty when it has none.
    pub encoding: &'a str,
    /// The sample's attachment.
    pub attachment: Option<&'a [u8]>,
    /// The sample's timestamp, nanoseconds since the Unix epoch.
    pub timestamp_ns: Option<u64>,
    /// How many samples came on this key before: the sequence number of a camera that sends none.
    pub arrival: u64,
    /// When it was received.
    pub received: Instant,
}

/// A frame, still encoded.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The camera's sequence number; by arrival when it sends none.
    pub sequence: u64,
    /// Capture time, nanoseconds since the Unix epoch: the camera's, else the sample's timestamp, else
    /// this machine's clock.
    pub time_ns: u64,
    /// The clip the camera says the frame belongs to.
    pub clip: Option<Arc<str>>,
    /// The picture, not decoded.
    pub picture: EncodedPicture,
    /// When the sample was received.
    pub received: Instant,
    /// Size of the payload.
    pub payload_bytes: usize,
}

/// A sample that is not a usable frame. Its number still counts as arrived, so that it is not counted
/// as lost too.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{fault}")]
pub struct RejectedFrame {
    /// Its sequence number, where it could be read.
    pub sequence: Option<u64>,
    /// Its clip, where it could be read.
    pub clip: Option<Arc<str>>,
    /// What was wrong.
    pub fault: FrameFault,
}

/// Reads a sample as a frame. Nothing is decoded; all limits are checked here, before memory is taken.
///
/// # Errors
/// [`RejectedFrame`] when the sample is too large, of an unknown format, or not a picture.
pub fn read_frame(
    raw: RawSample<'_>,
    format: PayloadFormat,
    limits: &FrameLimits,
) -> Result<Frame, RejectedFrame> {
    let _ = format;
    let fault = if raw.payload.len() > limits.max_payload_bytes {
        FrameFault::oversized("the payload is too large")
    } else {
        FrameFault::unknown_format("no format is read yet")
    };
    Err(RejectedFrame {
        sequence: Some(raw.arrival),
        clip: None,
        fault,
    })
}
