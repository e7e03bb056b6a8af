//! What a camera sends: payload formats, sequence numbers, the ring of newest frames, decoding, letterbox.

mod config;

pub use config::{Delivery, FrameLimits, PayloadFormat};
