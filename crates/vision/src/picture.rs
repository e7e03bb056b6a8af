//! Picture formats: reading headers, decoding within limits, letterbox.

mod decode;
mod decode_jpeg;
#[cfg(feature = "turbojpeg")]
mod decode_jpeg_scaled;
mod decode_png;
mod decode_raw;
mod fault;
mod files;
mod format;
mod header;
mod huffman;
mod input_format;
mod input_tensor;
mod letterbox;
mod limits;
mod mount;
mod orientation;
mod outline;
mod raw;
pub mod ros2;
mod stream;

pub use decode::{decode, decode_grey_half, decode_small_grey, to_jpeg};
pub use fault::FrameFault;
pub(crate) use files::is_hidden;
pub use files::{PictureFileError, is_picture_file, natural_key, picture_files, read_picture_file};
pub use format::{BayerPattern, EncodedPicture, Picture, PictureFormat, PixelLayout};
pub use header::{format_of, picture_of_file, picture_of_kind};
pub use input_format::{
    ColorOrder, Fit, InputElement, InputFormat, InputMapping, TensorLayout, ValueRange,
};
pub use input_tensor::InputTensor;
pub use letterbox::Letterbox;
pub use limits::{FrameLimits, check_payload, check_picture};
pub use mount::{Flip, Mask, Mount, Mounted};
pub use outline::{LineStyle, outline};
pub use raw::{raw_picture, raw_picture_of_rows};
pub use stream::{read_part, read_png, read_ppm};

/// The maximum number of scans of a progressive JPEG file; encoders use about ten. Each costs a pass over the picture,
/// and a small file can hold many.
const MAX_SCANS: u32 = 32;
