//! Runs a real detector over pictures.
//!
//! One pass over a clip's pictures ([`run_pass`]) runs the detector, at a low confidence, and the
//! empty-scene screen on every frame, and keeps their results and the time of each step. Every policy and
//! threshold then replays that [`Clip`](crate::data::Clip), so a sweep over fifteen settings costs one pass.

mod model_runner;
mod pass;

pub use model_runner::ModelRunner;
pub use pass::{PassSettings, run_pass};

/// The pass keeps detections from this confidence on; a run may use any higher one.
pub const LOWEST_CONFIDENCE: f64 = 0.05;
