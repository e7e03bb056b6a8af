//! Finds the value of a policy's threshold that meets a target on a recording, with and without the screen.
//!
//! A recording has the detections of the user's own detector on every frame. The policy is replayed over it with many
//! values of its threshold, and its boxes on the frames without the detector are compared with the detector's, as a
//! node's audit does with a sample. This needs no ground truth, so it cannot measure accuracy against the truth. Nor
//! can it compare policies: a policy that rightly keeps showing an object that the detector misses gets a worse figure.

mod choose;
mod estimate;
mod target;
mod text;
mod trial;

pub use choose::{Advice, advise};
pub use target::Target;
pub use text::render;
