//! What a camera sends: payload formats, sequence numbers, the ring of newest frames, decoding, letterbox.

mod attachment;
mod config;
mod decode;
mod decode_jpeg;
#[cfg(feature = "turbojpeg")]
mod decode_jpeg_scaled;
mod decode_png;
mod decode_raw;
mod fault;
mod header;
mod letterbox;
mod limits;
mod picture;
mod picture_files;
mod read;
mod ring;
mod ros2;
mod sequence;

pub use config::{Delivery, FrameLimits, PayloadFormat};
pub use decode::{decode, decode_grey_half, decode_small_grey, to_jpeg};
pub use fault::FrameFault;
pub use letterbox::{ColorOrder, Fit, InputFormat, Letterbox, TensorLayout, ValueRange};
pub use letterbox::{InputMapping, LetterboxError};
pub(crate) use limits::check_picture;
pub use picture::{EncodedPicture, Picture, PictureFormat, PixelLayout};
pub use picture_files::{PictureFileError, is_picture_file, picture_files, read_picture_file};
pub use read::picture_of_file;
pub(crate) use read::read_query;
pub use read::{Frame, FrameOrder, RawSample, RejectedFrame, read_frame, read_sample};
pub use ring::RingSender;
pub use ring::{Pushed, RingReceiver, frame_ring};
pub(crate) use sequence::{Arrival, SequenceTracker};

/// Most scans of a progressive JPEG file; encoders use about ten. Each costs a pass over the picture, and a small
/// file can hold many.
const MAX_SCANS: u32 = 32;
