//! The messages in protobuf: those of Foxglove, with the fields that are written here, and the node's figures.

use bytes::Bytes;
use prost_types::Timestamp;

/// The time of this many nanoseconds since the Unix epoch.
pub(crate) fn timestamp(t_ns: u64) -> Option<Timestamp> {
    Some(Timestamp {
        seconds: i64::try_from(t_ns / 1_000_000_000).ok()?,
        nanos: (t_ns % 1_000_000_000) as i32,
    })
}

/// `foxglove.CompressedImage`.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(bytes = "bytes", tag = "2")]
    pub data: Bytes,
    /// `jpeg`.
    #[prost(string, tag = "3")]
    pub format: String,
    #[prost(string, tag = "4")]
    pub frame_id: String,
}

/// `foxglove.ImageAnnotations`.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct ImageAnnotations {
    #[prost(message, repeated, tag = "2")]
    pub points: Vec<PointsAnnotation>,
    #[prost(message, repeated, tag = "3")]
    pub texts: Vec<TextAnnotation>,
    #[prost(message, optional, tag = "5")]
    pub timestamp: Option<Timestamp>,
}

/// The type of a [`PointsAnnotation`] whose last point is joined to its first.
pub(crate) const LINE_LOOP: i32 = 2;

/// `foxglove.PointsAnnotation`.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct PointsAnnotation {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(int32, tag = "2")]
    pub r#type: i32,
    #[prost(message, repeated, tag = "3")]
    pub points: Vec<Point2>,
    #[prost(message, optional, tag = "4")]
    pub outline_color: Option<Color>,
    /// Pixels.
    #[prost(double, tag = "7")]
    pub thickness: f64,
}

/// `foxglove.TextAnnotation`.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct TextAnnotation {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(message, optional, tag = "2")]
    pub position: Option<Point2>,
    #[prost(string, tag = "3")]
    pub text: String,
    /// Pixels.
    #[prost(double, tag = "4")]
    pub font_size: f64,
    #[prost(message, optional, tag = "5")]
    pub text_color: Option<Color>,
}

/// `foxglove.Point2`, in pixels.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(crate) struct Point2 {
    #[prost(double, tag = "1")]
    pub x: f64,
    #[prost(double, tag = "2")]
    pub y: f64,
}

/// `foxglove.Color`, from 0 to 1.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(crate) struct Color {
    #[prost(double, tag = "1")]
    pub r: f64,
    #[prost(double, tag = "2")]
    pub g: f64,
    #[prost(double, tag = "3")]
    pub b: f64,
    #[prost(double, tag = "4")]
    pub a: f64,
}

/// `foxglove.LocationFix`.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct LocationFix {
    /// Degrees.
    #[prost(double, tag = "1")]
    pub latitude: f64,
    /// Degrees.
    #[prost(double, tag = "2")]
    pub longitude: f64,
    #[prost(message, optional, tag = "6")]
    pub timestamp: Option<Timestamp>,
    #[prost(string, tag = "7")]
    pub frame_id: String,
}

/// `albireo.Figures`: what a viewer plots of a frame. What is absent in the frame's message is not a number (NaN), so
/// that a curve has a gap there.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Figures {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(uint64, tag = "2")]
    pub seq: u64,
    /// 0 to 4 for E, P, E+I, I, AI.
    #[prost(int32, tag = "3")]
    pub state: i32,
    /// True if the frame skipped the detector.
    #[prost(bool, tag = "4")]
    pub skipped: bool,
    /// True if the detector was needed but not available.
    #[prost(bool, tag = "5")]
    pub degraded: bool,
    /// The largest uncertainty τ.
    #[prost(double, tag = "6")]
    pub tau_max: f64,
    #[prost(double, tag = "7")]
    pub threshold: f64,
    #[prost(uint32, tag = "8")]
    pub boxes: u32,
    /// The objects (track ids) of the boxes, in their order.
    #[prost(uint64, repeated, tag = "9")]
    pub objects: Vec<u64>,
    /// From reception to the answer, milliseconds.
    #[prost(double, tag = "10")]
    pub latency_ms: f64,
    /// Speed over ground.
    #[prost(double, tag = "11")]
    pub speed_m_s: f64,
}
