//! Advice: which value of a policy's threshold meets a target on a recording, with and without the screen, at what loss.
//!
//! A recording is what the user's own detector said of every frame of a drive or a day. The policy is replayed over it with
//! many values of its threshold; what it shows on the frames without the detector is compared with what the detector said
//! of them, as a node's audit does with a sample. No ground truth is needed, so nothing is said of accuracy against the
//! truth. Policies are not compared: one that goes on showing what the detector misses loses here by being right.

mod choose;
mod estimate;
mod target;
mod text;
mod trial;

pub use choose::{Advice, advise};
pub use target::Target;
pub use text::render;
