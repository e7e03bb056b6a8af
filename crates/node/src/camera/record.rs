//! The record of a frame with its final answer.

use super::evidence::{DetectorRun, Times};
use albireo_wire::DetectionsMessage;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// A frame with its final answer: given once to everything that counts frames.
#[derive(Clone, Debug)]
pub struct FrameRecord {
    /// The final answer, as published.
    pub detections: Arc<DetectionsMessage>,
    /// When it was published.
    pub answered: Instant,
    /// From reception to the first answer, which may have been pending.
    pub first_answer: Duration,
    /// The detector's time, letterbox and waiting included.
    pub(crate) detector: Option<Duration>,
    /// The detector run that found the boxes.
    pub(crate) detector_run: Option<DetectorRun>,
    /// Whether a small grey picture was examined.
    pub(crate) examined: bool,
}

impl FrameRecord {
    /// A frame that neither detector nor flow examined, answered now and `first_answer` after its reception.
    pub fn new(detections: Arc<DetectionsMessage>, first_answer: Duration) -> Self {
        Self {
            detections,
            answered: Instant::now(),
            first_answer,
            detector: None,
            detector_run: None,
            examined: false,
        }
    }

    /// The same frame, of which `times` says what examined it.
    #[must_use]
    pub(crate) fn examined(self, times: &Times) -> Self {
        Self {
            detector: times.detector(),
            detector_run: times.detector_run,
            examined: times.examined,
            ..self
        }
    }
}
