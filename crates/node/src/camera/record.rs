//! The record of a frame with its final answer.

use super::evidence::Times;
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
    /// What the final answer took.
    pub(crate) times: Times,
}

impl FrameRecord {
    /// A frame that neither detector nor flow examined, answered now and `first_answer` after its reception.
    pub fn new(detections: Arc<DetectionsMessage>, first_answer: Duration) -> Self {
        Self {
            detections,
            answered: Instant::now(),
            first_answer,
            times: Times::default(),
        }
    }
}
