//! Footage: a video, a folder or an archive of pictures as a sequence of encoded pictures, the
//! form in which a camera sends them. `replay` publishes it; `eval` looks at it.

mod open;
mod pictures;
mod source;
mod thinned;
mod video;

pub use open::SourceName;
pub use pictures::Pictures;
pub use source::{FrameSource, Stopper};
pub use thinned::{Sieve, Thinned};
pub use video::{Ffmpeg, Video, VideoEncoding};
