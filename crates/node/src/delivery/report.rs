//! From closed clips to reports. Each camera's loop keeps its accounts; behind them a task adds the energy, keeps the
//! report in the outbox and publishes it for whoever listens.

use crate::camera::audit::CameraAudit;
use crate::camera::clip::{ClipMeta, ClipTracker, ClosedClip, FrameArrival, FrameResult};
use crate::camera::evidence::DetectorRun;
use crate::camera::publishing::PublishLane;
use crate::delivery::outbox::Outbox;
use crate::input::receiver::DropCounts;
use crate::state::board::Board;
use albireo_vision::detector::DetectorHandle;
use albireo_wire::ClipReport;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// Counts one camera's open clip in its loop and hands closed clips to the camera's [`Reporter`].
#[derive(Debug)]
pub(crate) struct ClipAccounts {
    tracker: ClipTracker,
    drops: Arc<DropCounts>,
    audit: Arc<CameraAudit>,
    closed: mpsc::UnboundedSender<ClosedClip>,
}

impl ClipAccounts {
    /// Accounts with no clip yet that give closed clips to a [`Reporter`]. The channel is unbounded, because a
    /// clip is some kilobytes every some seconds and must not be lost; the reporter's own waiting is bounded.
    pub(crate) fn new(
        tracker: ClipTracker,
        drops: Arc<DropCounts>,
        audit: Arc<CameraAudit>,
        closed: mpsc::UnboundedSender<ClosedClip>,
    ) -> Self {
        Self {
            tracker,
            drops,
            audit,
            closed,
        }
    }

    /// Takes note of a frame about to be processed and gives the clip it belongs to.
    pub(crate) fn arrive(&mut self, frame: &FrameArrival<'_>) -> Arc<str> {
        // What was dropped before this frame belongs to the clip that was open then.
        self.take_counts();
        let closed = self.tracker.arrive(frame);
        self.hand_over(closed);
        self.tracker.clip().map_or_else(|| "".into(), Arc::clone)
    }

    /// Notes what this camera used of a run of the detector.
    pub(crate) fn detector_ran(&mut self, run: DetectorRun) {
        self.tracker.detector_ran(run.end, run.used);
    }

    /// Counts the outcome of the frame that arrived last.
    pub(crate) fn count(&mut self, result: &FrameResult) {
        self.tracker.count(result);
    }

    /// When [`tick`](Self::tick) should be called, should no frame come before.
    pub(crate) fn deadline(&self) -> Option<Instant> {
        self.tracker.deadline()
    }

    /// Ends the clip whose time is up.
    pub(crate) fn tick(&mut self) {
        self.take_counts();
        let closed = self.tracker.tick(Instant::now());
        self.hand_over(closed);
    }

    /// Ends the open clip because the node stops.
    pub(crate) fn shutdown(&mut self) {
        self.take_counts();
        let closed = self.tracker.shutdown(Instant::now());
        self.hand_over(closed);
    }

    /// Takes over what others counted for the open clip.
    fn take_counts(&mut self) {
        self.tracker.dropped(&self.drops.take());
        if let Some(found) = self.audit.take() {
            self.tracker.audited(&found);
        }
    }

    fn hand_over(&self, closed: Option<ClosedClip>) {
        if let Some(closed) = closed
            && self.closed.send(closed).is_err()
        {
            tracing::error!("a clip ended and nobody reports it");
        }
    }
}

/// Keeps and publishes one camera's clip reports.
pub(crate) struct Reporter {
    /// Where reports are shown.
    pub board: Arc<Board>,
    /// The camera's name.
    pub camera: String,
    /// What ran the detector.
    pub detector: DetectorHandle,
    /// For whoever listens; the hub's way is the outbox.
    pub listeners: PublishLane,
    /// Where reports are kept until a hub has them.
    pub outbox: Outbox,
}

/// Clips that are kept together when they end faster than a disk syncs.
const TOGETHER: usize = 256;

impl Reporter {
    /// Reports until the accounts are gone and the last clip is kept.
    pub(crate) async fn run(&self, clips: &mut mpsc::UnboundedReceiver<ClosedClip>) {
        let mut closed = Vec::new();
        while clips.recv_many(&mut closed, TOGETHER).await > 0 {
            self.report(std::mem::take(&mut closed)).await;
        }
    }

    /// Keeps the reports first, as far as they are known; then adds the energy, which may take a moment.
    async fn report(&self, closed: Vec<ClosedClip>) {
        let provisional = closed
            .iter()
            .map(|clip| clip.without_energy(self.meta(0)))
            .collect();
        let Some((tickets, kept)) = self
            .on_disk(provisional, |outbox, reports| outbox.keep(reports))
            .await
        else {
            return;
        };
        let mut reports = Vec::with_capacity(kept.len());
        for (clip, kept) in closed.into_iter().zip(kept) {
            let mut report = clip.into_report(self.meta(kept.report)).await;
            report.round();
            tracing::info!(
                camera = self.camera,
                clip = report.clip,
                frames = report.frames,
                skip_rate = report.skip_rate,
                joules = report.energy.joules,
                quality = ?report.energy.quality,
                "clip ended"
            );
            reports.push(report);
        }
        let settled = self
            .on_disk(reports, move |outbox, reports| {
                outbox.settle(&tickets, reports);
            })
            .await;
        for report in settled.into_iter().flat_map(|((), reports)| reports) {
            match serde_json::to_vec(&report) {
                Ok(json) => self.listeners.publish(json),
                Err(error) => {
                    tracing::error!(camera = self.camera, %error, "clip report not written");
                }
            }
            self.board.record_clip(report);
        }
    }

    fn meta(&self, number: u64) -> ClipMeta {
        ClipMeta {
            node: self.board.node().to_owned(),
            camera: self.camera.clone(),
            report: number,
            policy: self.board.policy().to_owned(),
            model: self.detector.model_name().to_owned(),
            provider: self.detector.provider().as_str().to_owned(),
        }
    }

    /// Lets the outbox work on `reports` where a disk may take its time.
    async fn on_disk<T: Send + 'static>(
        &self,
        mut reports: Vec<ClipReport>,
        work: impl FnOnce(&Outbox, &mut [ClipReport]) -> T + Send + 'static,
    ) -> Option<(T, Vec<ClipReport>)> {
        let outbox = self.outbox.clone();
        let worked = tokio::task::spawn_blocking(move || {
            let result = work(&outbox, &mut reports);
            (result, reports)
        });
        worked
            .await
            .inspect_err(|error| tracing::error!(camera = self.camera, %error, "clip reports lost"))
            .ok()
    }
}
