//! Picture sources that are kept open: a network camera, a device, a video file, a folder of them or a GStreamer pipeline.
//! A program, ffmpeg or GStreamer, opens the source and writes its pictures, which are read here.
//!
//! | file | contents |
//! | --- | --- |
//! | `address` | the address of a source and its options, shown without secrets |
//! | `templates` | the command lines of ffmpeg and GStreamer |
//! | `program` | a program that writes pictures: started, read with a deadline, ended |
//! | `messages` | what such a program says: why it fails, which pictures are broken |
//! | `files` | several video files as one source |
//! | `login` | which logins a camera takes that has refused one |
//! | `live` | a source that is reopened whenever it ends |

mod address;
mod files;
mod live;
mod login;
mod messages;
mod program;
mod templates;

pub use address::{SourceAddress, SourceKind, SourceOptions};
pub use files::Recorded;
pub use live::{LiveSource, SourceEvent};
pub(crate) use program::FIRST_PICTURE;
pub use templates::{RtspTransport, SourceSettings};

#[cfg(test)]
mod tests;
