//! Creates the reports of clips that a camera's loop has closed: waits for the energy, keeps the report in the outbox
//! and publishes it for subscribers.

use crate::camera::clip::Clip;
use crate::outbox::Outbox;
use crate::state::board::{Board, CameraBoard, provider};
use albireo_power::Measured;
use albireo_service::clock::Now;
use albireo_wire::{ClipReport, significant};
use std::sync::Arc;
use tokio::sync::mpsc;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh_ext::AdvancedPublisher;

/// Keeps and publishes one camera's clip reports.
pub(crate) struct Reporter {
    /// Shows reports.
    pub board: Arc<Board>,
    /// Keeps reports until a hub has them.
    pub outbox: Arc<Outbox>,
    /// Counts the unpublished reports.
    pub camera: Arc<CameraBoard>,
    /// Publishes reports to subscribers. The hub gets them from the outbox.
    pub listeners: AdvancedPublisher<'static>,
}

/// The maximum number of clips kept together when they end faster than the disk syncs.
const MAX_BATCH: usize = 256;

impl Reporter {
    /// Reports until the camera's loop is dropped and the last clip is kept.
    pub(crate) async fn run(self, mut clips: mpsc::UnboundedReceiver<Clip>) {
        let mut closed = Vec::new();
        while clips.recv_many(&mut closed, MAX_BATCH).await > 0 {
            self.report(std::mem::take(&mut closed)).await;
        }
    }

    /// Waits for the clips' energy, keeps their reports, and publishes them.
    async fn report(&self, closed: Vec<Clip>) {
        let mut measured = Vec::with_capacity(closed.len());
        for clip in closed {
            let energy = clip.energy().await;
            measured.push((clip, energy));
        }
        let board = Arc::clone(&self.board);
        let outbox = Arc::clone(&self.outbox);
        let camera = Arc::clone(&self.camera);
        let keeping = tokio::task::spawn_blocking(move || {
            let provider = provider(&board.detector_status()).unwrap_or("none");
            let target = board.target.report().target;
            let report = |(clip, energy): (Clip, Measured)| {
                let mut report = ClipReport {
                    node: board.node.clone(),
                    camera: camera.name().to_owned(),
                    model: board.model.clone(),
                    provider: provider.to_owned(),
                    target,
                    ..clip.into_report(energy)
                };
                report.round();
                report
            };
            let mut reports: Vec<_> = measured.into_iter().map(report).collect();
            outbox.change(|waiting| waiting.insert(&mut reports, Now::system()));
            reports
        });
        let camera = self.camera.name();
        let kept = match keeping.await {
            Ok(kept) => kept,
            Err(error) => {
                tracing::error!(camera, %error, "clip reports lost");
                return;
            }
        };
        for report in kept {
            tracing::info!(
                camera,
                clip = report.clip,
                // Most clips have one part.
                part = (report.part > 0).then_some(report.part),
                frames = report.frames,
                skip_rate = significant(report.skip_rate, 3),
                joules = report.energy.joules.map(|joules| significant(joules, 4)),
                quality = report.energy.quality.as_str(),
                "clip ended"
            );
            // Cannot fail: a report holds numbers and text.
            let json = serde_json::to_vec(&report).unwrap_or_default();
            let published = self.listeners.put(json).encoding(Encoding::APPLICATION_JSON).wait();
            if let Err(error) = published {
                self.camera.unpublished.count();
                tracing::debug!(camera, %error, "a clip report was not published");
            }
            self.board.record_clip(report);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PreparedNode;
    use crate::camera::clip::{ClipConfig, ClipTracker};
    use crate::config::NodeConfig;
    use albireo_power::PowerHandle;
    use tokio::time::Instant;
    use zenoh_ext::AdvancedPublisherBuilderExt;

    #[tokio::test(flavor = "multi_thread")]
    async fn a_report_that_is_not_published_is_counted_and_kept_for_the_hub() {
        let node = PreparedNode::new(&NodeConfig::default()).unwrap();
        let board = Arc::clone(&node.board);
        let camera = Arc::clone(&board.cameras[0]);
        let session = crate::api::name::tests::session_alone().await;
        let listeners = session.declare_publisher("clip").advanced().await.unwrap();
        let reporter = Reporter {
            board,
            outbox: Arc::clone(&node.outbox),
            camera: Arc::clone(&camera),
            listeners,
        };
        let energy = PowerHandle::none().camera();
        let mut tracker = ClipTracker::new(ClipConfig::default(), energy, None, "albireo");
        let mut clip = || {
            tracker.arrive(0, Some("drive"), Instant::now());
            tracker.shutdown(Instant::now()).into_iter().collect()
        };
        reporter.report(clip()).await;
        assert_eq!(camera.snapshot().unpublished, 0);
        session.close().await.unwrap();
        reporter.report(clip()).await;
        assert_eq!(camera.snapshot().unpublished, 1);
        assert_eq!(node.outbox.counts().kept, 2);
    }
}
