//! Evaluation on pictures with a real detector.
//!
//! One pass over a clip's pictures ([`collect`]) asks the detector, at a low confidence, and the
//! empty-scene screen about every frame and keeps what they say, with the time each step took. Every
//! policy and threshold then replays that [`Clip`](crate::data::Clip): a sweep over fifteen settings costs one pass.

mod observer;
mod pass;
mod truth;

pub use observer::Observer;
pub use pass::{Pass, PassSettings, StepTimes, collect, looks_at_pixels};
pub use truth::{GroundTruth, TruthFormat, against_vanilla};

/// The pass keeps detections from this confidence on, so that a run may ask for any above it.
pub const LOWEST_CONFIDENCE: f64 = 0.05;
