//! Pictures of a source that the node itself keeps open, on their way into a camera's ring.

use super::FrameReceiver;
use crate::input::source::{LiveSource, SourceSink};
use albireo_service::readiness::Part;
use albireo_vision::picture::{EncodedPicture, FrameFault};
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// A camera's source, and where its pictures go.
#[derive(Clone, Debug)]
pub(crate) struct SourceFeed {
    pub source: Arc<LiveSource>,
    pub receiver: Arc<FrameReceiver>,
    /// The camera's part of the readiness.
    pub part: Part,
}

impl SourceFeed {
    /// Feeds the camera until `shutdown`.
    ///
    /// # Errors
    /// When the thread that reads fails.
    pub(crate) async fn run(self, shutdown: CancellationToken) -> Result<(), String> {
        let source = Arc::clone(&self.source);
        source.run(self, shutdown).await
    }
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
