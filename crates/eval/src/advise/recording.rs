//! What was recorded of one clip.

use crate::data::Clip;
use crate::pictures::PicturedClip;
use crate::statistics::mean;

/// A clip with the detector's answer to every frame.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The clip; it needs detections and no ground truth.
    pub clip: Clip,
    /// Mean milliseconds of the detector on a frame, where it was timed.
    pub detector_ms: Option<f64>,
}

impl From<Clip> for Recording {
    fn from(clip: Clip) -> Self {
        Self {
            clip,
            detector_ms: None,
        }
    }
}

impl From<PicturedClip> for Recording {
    fn from(pictured: PicturedClip) -> Self {
        Self {
            detector_ms: mean(pictured.times.iter().map(|times| times.detector)),
            clip: pictured.clip,
        }
    }
}
