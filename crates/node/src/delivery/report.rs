//! Makes reports of the clips that a camera's loop has closed: waits for the energy, keeps the report in the outbox and
//! publishes it for subscribers.

use crate::camera::clip::Clip;
use crate::state::board::Board;
use albireo_power::Measured;
use albireo_service::clock::Now;
use albireo_vision::detector::DetectorHandle;
use albireo_wire::ClipReport;
use std::sync::Arc;
use tokio::sync::mpsc;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh_ext::AdvancedPublisher;

/// Keeps and publishes one camera's clip reports.
pub(crate) struct Reporter {
    /// Where reports are shown, and kept until a hub has them.
    pub board: Arc<Board>,
    /// The camera's name.
    pub camera: String,
    /// What ran the detector.
    pub detector: DetectorHandle,
    /// For subscribers; the hub gets it from the outbox.
    pub listeners: AdvancedPublisher<'static>,
}

/// Clips that are kept together when they end faster than a disk syncs.
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
        let camera = self.camera.clone();
        let model = self.detector.model_name().to_owned();
        let provider = self.detector.provider().as_str().to_owned();
        let kept = tokio::task::spawn_blocking(move || {
            let report = |(clip, energy): (Clip, Measured)| {
                let mut report = ClipReport {
                    node: board.node.clone(),
                    camera: camera.clone(),
                    policy: board.policy.to_owned(),
                    model: model.clone(),
                    provider: provider.clone(),
                    ..clip.into_report(energy)
                };
                report.round();
                report
            };
            let mut reports: Vec<_> = measured.into_iter().map(report).collect();
            board.outbox.insert(&mut reports, Now::system());
            reports
        });
        let kept = kept.await.unwrap_or_else(|error| {
            tracing::error!(camera = self.camera, %error, "clip reports lost");
            Vec::new()
        });
        for report in kept {
            tracing::info!(
                camera = self.camera,
                clip = report.clip,
                part = report.part,
                frames = report.frames,
                skip_rate = report.skip_rate,
                joules = report.energy.joules,
                quality = ?report.energy.quality,
                "clip ended"
            );
            match serde_json::to_vec(&report) {
                Ok(json) => self.publish(json),
                Err(error) => {
                    tracing::error!(camera = self.camera, %error, "clip report not written");
                }
            }
            self.board.record_clip(report);
        }
    }

    fn publish(&self, json: Vec<u8>) {
        let put = self.listeners.put(json);
        if let Err(error) = put.encoding(Encoding::APPLICATION_JSON).wait() {
            tracing::debug!(camera = self.camera, %error, "a clip report was not published");
        }
    }
}
