//! Reads footage (a video, several as a dashcam writes them, a recording, or a folder or an archive of pictures) as a
//! sequence of encoded pictures, the form in which a camera sends them.

mod archive;
mod downsampled;
mod open;
mod pace;
mod pictures;
mod recording;
mod riff;
mod source;
mod video;
mod video_files;

pub use downsampled::Downsampled;
pub(crate) use downsampled::FrameSelection;
pub use open::SourceName;
pub(crate) use pace::Pace;
pub use pictures::Pictures;
pub use source::{FrameSource, Stopper};
pub(crate) use source::{clip_name, unused_name};
pub use video::{Ffmpeg, Video, VideoEncoding};
pub use video_files::VideoFiles;
