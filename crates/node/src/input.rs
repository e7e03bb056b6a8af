//! What a camera sends: how its frames are read and numbered, the ring they wait in, and cameras that the node opens.

mod attachment;
mod config;
mod read;
pub(crate) mod receiver;
mod ring;
mod ros2;
mod sequence;
pub mod source;

pub use config::{Delivery, PayloadFormat};
pub use read::{Frame, RawSample, RejectedFrame, read_frame};
pub(crate) use ring::{Pushed, Ring, RingLimits};
pub use sequence::FrameNumber;
