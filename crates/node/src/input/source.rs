//! Picture sources that are kept open: a network camera, a device, a video file, a folder of them or a GStreamer pipeline.
//! A program, ffmpeg or GStreamer, opens the source and writes its pictures, which are read here.
//!
//! | file | contents |
//! | --- | --- |
//! | `address` | the address of a source, shown without a password |
//! | `options` | the options of ffmpeg for a source, shown without secrets |
//! | `secrets` | what is masked in the messages of programs |
//! | `settings` | a source to open, and how to open it |
//! | `ffmpeg`, `gstreamer` | the command lines of these programs |
//! | `program` | a program that writes pictures: started, read with a deadline, ended |
//! | `messages` | what such a program says: why it fails, which pictures are broken |
//! | `files` | several video files as one source |
//! | `login` | what a camera answers that gives no pictures: which logins it takes, or something else |
//! | `live` | a source that is reopened whenever it ends, and in `live/reading` how it is read once |

mod address;
mod ffmpeg;
mod files;
mod gstreamer;
mod live;
mod login;
mod messages;
mod options;
mod program;
mod secrets;
mod settings;

pub use address::{SourceAddress, SourceKind};
pub use files::Recorded;
pub use live::{LiveSource, SourceEvent, SourcePicture};
pub use options::SourceOptions;
pub(crate) use program::FIRST_PICTURE;
pub use settings::{RtspTransport, SourceSettings};

#[cfg(test)]
mod tests;
