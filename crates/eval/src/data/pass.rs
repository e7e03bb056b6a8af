//! Defines what a detector's pass over a clip's pictures keeps besides detections and verdicts.

use albireo_vision::picture::Picture;

/// The milliseconds that each step took on one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepTimes {
    /// Decoding to colour.
    pub decode: f64,
    /// The detector: letterbox, model and head.
    pub detector: f64,
    /// The screen; 0 without one.
    pub screen: f64,
    /// Decoding to grey at half size; 0 if it is not kept.
    pub grey: f64,
    /// Decoding to a small grey picture; 0 if it is not kept.
    pub small: f64,
}

/// The data that the pass over a clip's pictures keeps besides detections and verdicts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pass {
    /// The grey picture of each frame at half size; empty if not kept.
    pub grey: Vec<Picture>,
    /// The small grey picture of each frame; empty if not kept.
    pub small: Vec<Picture>,
    /// The width for which the small grey pictures were made.
    pub small_width: Option<u32>,
    /// The time of each step on each frame.
    pub times: Vec<StepTimes>,
}
