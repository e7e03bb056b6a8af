//! What a camera sends: payload formats, sequence numbers, the ring of newest frames; and cameras that the node opens.

mod attachment;
mod config;
pub mod intake;
mod read;
mod ring;
mod ros2;
mod sequence;
pub mod source;

pub use config::{Delivery, PayloadFormat};
pub(crate) use read::read_query;
pub use read::{Frame, FrameOrder, RawSample, RejectedFrame, read_frame, read_sample};
pub use ring::RingSender;
pub use ring::{Pushed, RingReceiver, frame_ring};
pub(crate) use sequence::{Arrival, SequenceTracker};
