//! Pictures of a source that the node itself keeps open, on their way into a camera's ring.

use super::FrameReceiver;
use crate::input::source::SourceSink;
use albireo_service::readiness::Part;
use albireo_vision::picture::{EncodedPicture, FrameFault};
use std::sync::Arc;
use std::time::Duration;

/// Where the pictures of a camera's source go.
#[derive(Clone, Debug)]
pub(crate) struct SourceFeed {
    pub receiver: Arc<FrameReceiver>,
    /// The camera's part of the readiness.
    pub part: Part,
}

impl SourceSink for SourceFeed {
    fn picture(&mut self, picture: Result<EncodedPicture, FrameFault>, reopened: bool) {
        self.receiver.take_picture(picture, reopened);
    }

    fn works(&mut self) {
        self.part.works();
    }

    fn fails(&mut self, reason: &str, pause: Duration) {
        let seconds = pause.as_secs_f64();
        self.part
            .degraded(format!("failed: {reason}; next attempt in {seconds} s"));
    }
}
