//! Sources of pictures: a network camera, a device, a video file or a GStreamer pipeline, opened by a child process whose
//! output is read. The node's own cameras and `albireo publish` come from here.
//!
//! | file | what is in it |
//! | --- | --- |
//! | `address` | what a source is called, what of it is secret, how it is shown |
//! | `ffmpeg`, `gstreamer` | how the two programs are told what to do |
//! | `program` | a program that runs: started, listened to, killed with its owner |
//! | `live` | a source that is opened again and again |

mod address;
mod ffmpeg;
mod gstreamer;
mod limit;
mod live;
mod program;

pub use address::{AddressError, SourceAddress, SourceKind};
pub use ffmpeg::{Ffmpeg, FfmpegInput, Handover, RtspTransport};
pub use live::{LiveSource, SourceSettings, SourceSink};
pub use program::{Running, SourceError, Stop};
