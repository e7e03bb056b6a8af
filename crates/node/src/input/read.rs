//! Reads a Zenoh sample or query as a frame with a still encoded picture.

use super::attachment::read_attachment;
use super::{FrameNumber, PayloadFormat};
use albireo_core::geometry::PictureSize;
use albireo_service::clock::unix_nanoseconds;
use albireo_vision::picture::ros2::{self, StampedPicture};
use albireo_vision::picture::{
    EncodedPicture, FrameFault, FrameLimits, PictureFormat, check_payload, format_of,
    picture_of_kind, raw_picture,
};
use albireo_wire::{FrameAttachment, Position};
use bytes::Bytes;
use std::borrow::Cow;
use std::sync::Arc;
use tokio::time::Instant;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;
use zenoh::sample::Sample;

/// A sample on a frame key.
#[derive(Clone, Debug)]
pub struct RawSample<'a> {
    /// The payload.
    pub payload: Bytes,
    /// The sample's Zenoh encoding as text, for example `image/jpeg`; empty if it has none.
    pub encoding: Cow<'a, str>,
    /// The sample's attachment.
    pub attachment: Option<Cow<'a, [u8]>>,
    /// The sample's timestamp, nanoseconds since the Unix epoch.
    pub timestamp_ns: Option<u64>,
    /// The number of earlier samples on the key: the sequence number for a camera that sends none.
    pub arrival: u64,
    /// The time of reception.
    pub received: Instant,
}

/// A frame, still encoded.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The camera's sequence number; the number by arrival if it sends none.
    pub sequence: u64,
    /// Capture time, nanoseconds since the Unix epoch: the camera's, else the sample's timestamp, else
    /// this machine's clock.
    pub time_ns: u64,
    /// The frame's clip, as named by the camera.
    pub clip: Option<Arc<str>>,
    /// The frame's position, or why what the camera sent is none; `None` if it sends none.
    pub position: Option<Result<Position, String>>,
    /// The picture, still encoded.
    pub picture: EncodedPicture,
    /// The time at which the sample was received.
    pub received: Instant,
}

impl<'a> From<&'a Sample> for RawSample<'a> {
    fn from(sample: &'a Sample) -> Self {
        Self {
            payload: shared_bytes(sample.payload()),
            encoding: sample.encoding().into(),
            attachment: sample.attachment().map(ZBytes::to_bytes),
            timestamp_ns: sample
                .timestamp()
                .and_then(|stamp| u64::try_from(stamp.get_time().to_duration().as_nanos()).ok()),
            arrival: 0,
            received: Instant::now(),
        }
    }
}

impl<'a> From<&'a Query> for RawSample<'a> {
    fn from(query: &'a Query) -> Self {
        Self {
            payload: query.payload().map_or_else(Bytes::new, shared_bytes),
            encoding: query.encoding().map(Cow::from).unwrap_or_default(),
            attachment: query.attachment().map(ZBytes::to_bytes),
            timestamp_ns: None,
            arrival: 0,
            received: Instant::now(),
        }
    }
}

/// The payload as shared bytes: not copied if Zenoh holds it in one piece.
fn shared_bytes(payload: &ZBytes) -> Bytes {
    /// Owns the Zenoh buffer behind a `Bytes`; contiguous, as checked at construction.
    struct OnePiece(ZBytes);
    impl AsRef<[u8]> for OnePiece {
        fn as_ref(&self) -> &[u8] {
            self.0.slices().next().unwrap_or_default()
        }
    }
    let mut slices = payload.slices();
    match (slices.next(), slices.next()) {
        (None, _) => Bytes::new(),
        (Some(_), None) => Bytes::from_owner(OnePiece(payload.clone())),
        (Some(_), Some(_)) => Bytes::from(payload.to_bytes().into_owned()),
    }
}

/// Reads the camera's number of a sample, and the frame, or its fault if it is too large, has an unknown format or is
/// not a picture. Decodes nothing, and checks all limits before it allocates.
pub fn read_frame(
    raw: RawSample<'_>,
    format: PayloadFormat,
    limits: &FrameLimits,
) -> (FrameNumber, Result<Frame, FrameFault>) {
    let attachment = match read_attachment(raw.attachment.as_deref(), format) {
        Ok(attachment) => attachment,
        Err(fault) => return (FrameNumber::default(), Err(fault)),
    };
    let read = check_payload(raw.payload.len(), limits)
        .and_then(|()| read_picture(&raw, &attachment, format, limits));
    let number = FrameNumber {
        seq: attachment.seq,
        stream: attachment.stream,
    };
    let frame = read.map(|(picture, stamp)| Frame {
        sequence: number.seq.unwrap_or(raw.arrival),
        // A ROS header's stamp is the time of capture, the attachment's the time of sending.
        time_ns: stamp.or(attachment.t_ns).or(raw.timestamp_ns).unwrap_or_else(unix_nanoseconds),
        position: attachment.position(),
        clip: attachment.clip.map(Arc::from),
        picture,
        received: raw.received,
    });
    (number, frame)
}

/// The picture, and its capture time if the payload has one.
fn read_picture(
    raw: &RawSample<'_>,
    attachment: &FrameAttachment,
    format: PayloadFormat,
    limits: &FrameLimits,
) -> Result<StampedPicture, FrameFault> {
    match format {
        PayloadFormat::Encoding => {
            read_by_encoding(raw, attachment, limits).map(|picture| (picture, None))
        }
        PayloadFormat::Ros2 => ros2::read_message(&raw.payload, limits),
    }
}

fn read_by_encoding(
    raw: &RawSample<'_>,
    attachment: &FrameAttachment,
    limits: &FrameLimits,
) -> Result<EncodedPicture, FrameFault> {
    let (kind, schema) = raw.encoding.split_once(';').unwrap_or((&raw.encoding, ""));
    let kind = kind.trim().to_ascii_lowercase();
    let bytes = raw.payload.clone();
    match kind.as_str() {
        "image/jpeg" | "image/jpg" => picture_of_kind(PictureFormat::Jpeg, bytes, limits),
        "image/png" => picture_of_kind(PictureFormat::Png, bytes, limits),
        "" | "zenoh/bytes" | "application/octet-stream" => match format_of(&bytes) {
            Some(format) => picture_of_kind(format, bytes, limits),
            None => Err(FrameFault::unknown_format(format!(
                "the payload has no encoding and is neither a JPEG nor a PNG file; {ENCODINGS}"
            ))),
        },
        "image/raw" => {
            let Some(format) = PictureFormat::raw_from_name(schema.trim()) else {
                return Err(unknown_encoding(&raw.encoding));
            };
            let (Some(width), Some(height)) = (attachment.width, attachment.height) else {
                let reason = "a raw picture needs `width` and `height` in the attachment";
                return Err(FrameFault::unknown_format(reason));
            };
            let size = PictureSize::new(width, height);
            raw_picture(format, size, bytes, limits)
        }
        _ => Err(unknown_encoding(&raw.encoding)),
    }
}

const ENCODINGS: &str = "send image/jpeg, image/png, or image/raw;FORMAT with rgb8, bgr8, rgba8, bgra8, gray8, gray16, nv12, nv21, nv24, i420, yuyv, uyvy, or bayer_rggb8 and the like";

fn unknown_encoding(encoding: &str) -> FrameFault {
    let start: String = encoding.chars().take(64).collect();
    FrameFault::unknown_format(format!("unknown encoding {start:?}; {ENCODINGS}"))
}
