//! Advice: which policy, value of its knob, and screen meet a target on a recording, at what saving and what loss.
//!
//! A recording is what the user's own detector said of every frame of a drive or a day. Candidates are replayed over it
//! with many values of their knobs; what each shows on the frames without the detector is compared with what the detector
//! said of them, as a node's audit does with a sample. No ground truth is needed, and so nothing is said of accuracy
//! against the truth: the reference is the detector.

mod choose;
mod estimate;
mod recording;
mod target;
mod text;
mod trial;

pub use choose::{Advice, Proposal, advise};
pub use estimate::Estimate;
pub use recording::Recording;
pub use target::{Target, TargetError, parse_target, target_in_words};
pub use text::render;
pub use trial::{AdviceError, Costs, Settings};
