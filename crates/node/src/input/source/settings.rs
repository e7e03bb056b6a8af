//! A source to open, and how to open it.

use super::address::SourceAddress;
use super::options::SourceOptions;
use albireo_vision::picture::FrameLimits;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The transport of an RTSP camera's packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum RtspTransport {
    /// In the open connection: no packet is lost, and no firewall is in the way.
    #[default]
    Tcp,
    /// In datagrams: a lost one breaks pictures.
    Udp,
}

impl RtspTransport {
    pub(super) const fn as_str(self) -> &'static str {
        match self {
            Self::Tcp => "tcp",
            Self::Udp => "udp",
        }
    }
}

/// A source to open, and how to open it.
#[derive(Clone, Debug)]
pub struct SourceSettings {
    /// The source.
    pub address: SourceAddress,
    /// Maximum frames per second.
    pub max_rate: Option<f64>,
    /// The transport of RTSP packets.
    pub transport: RtspTransport,
    /// Acceleration or decoder of ffmpeg.
    pub hardware: Option<String>,
    /// Options of ffmpeg for the source.
    pub options: SourceOptions,
    /// A source without a picture for this long is reopened.
    pub silence: Duration,
    /// True if decoded pictures are encoded as JPEG files; otherwise they stay pixels.
    pub as_jpeg: bool,
    /// Limits of the pictures.
    pub limits: FrameLimits,
}
