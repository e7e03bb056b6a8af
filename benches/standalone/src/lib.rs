//! What the benches beside other trackers share: albireo's core, average precision, and the scene they track.

pub use albireo_core::{detection, geometry, kalman, objects, policy};

#[allow(dead_code)]
#[path = "../../../crates/eval/src/average_precision.rs"]
pub mod average_precision;

pub mod scene;
