//! What a camera sends: payload formats, sequence numbers, the ring of newest frames, decoding, letterbox.

mod config;
mod decode;
mod fault;
mod letterbox;
mod picture;
mod read;
mod ring;
mod sequence;

pub use config::{Delivery, FrameLimits, PayloadFormat};
pub use decode::{decode, decode_grey_half, to_jpeg};
pub use fault::FrameFault;
pub use letterbox::{
    ColorOrder, Fit, InputFormat, InputMapping, Letterbox, LetterboxError, ValueRange,
};
pub use picture::{EncodedPicture, Picture, PictureFormat, PixelLayout};
pub use read::{Frame, RawSample, RejectedFrame, read_frame};
pub use ring::{Pushed, RingReceiver, RingSender, frame_ring};
pub use sequence::{Arrival, SequenceTracker};
