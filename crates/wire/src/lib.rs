//! What goes over Zenoh: key expressions and the JSON messages on them. Node, hub and clients use these
//! types and no others.

mod keys;
mod knob;
mod messages;

pub use albireo_core::policy::{Knob, KnobError};
pub use keys::{CameraKeys, KeyError, NodeKeys, check_segment};
pub use knob::WrongKnob;
pub use knob::{KnobChange, KnobValue, ThresholdMessage};
pub use messages::*;
