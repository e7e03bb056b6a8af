//! Makes reports of closed clips: each camera's loop counts its open clip, and a task behind it waits for the energy, keeps
//! the report in the outbox and publishes it for subscribers.

use crate::camera::FrameRecord;
use crate::camera::audit::CameraAudit;
use crate::camera::clip::{ClipMeta, ClipTracker, ClosedClip, FrameArrival, MeasuredClip};
use crate::camera::publishing::PublishLane;
use crate::input::receiver::DropCounts;
use crate::state::board::Board;
use albireo_service::clock::Now;
use albireo_vision::detector::DetectorHandle;
use albireo_wire::Threshold;
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

    /// The frame that arrived last is pending: it is counted by [`count_late`](Self::count_late).
    pub(crate) fn pending(&mut self, seq: u64, threshold: Option<Threshold>) {
        self.tracker.pending(seq, threshold);
    }

    /// Counts the frame that arrived last.
    pub(crate) fn count(&mut self, frame: &FrameRecord) {
        self.tracker.count(frame);
    }

    /// Counts the pending frame.
    pub(crate) fn count_late(&mut self, frame: &FrameRecord) {
        let closed = self.tracker.count_late(frame);
        self.hand_over(closed);
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
        let ended = self.tracker.nothing_is_pending();
        self.hand_over(ended);
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
            tracing::error!("a clip ended and its reporter has stopped");
        }
    }
}

/// Keeps and publishes one camera's clip reports.
pub(crate) struct Reporter {
    /// Where reports are shown, and kept until a hub has them.
    pub board: Arc<Board>,
    /// The camera's name.
    pub camera: String,
    /// What ran the detector.
    pub detector: DetectorHandle,
    /// For subscribers; the hub gets it from the outbox.
    pub listeners: PublishLane,
}

/// Clips that are kept together when they end faster than a disk syncs.
const MAX_BATCH: usize = 256;

impl Reporter {
    /// Reports until the accounts are dropped and the last clip is kept.
    pub(crate) async fn run(self, mut clips: mpsc::UnboundedReceiver<ClosedClip>) {
        let mut closed = Vec::new();
        while clips.recv_many(&mut closed, MAX_BATCH).await > 0 {
            self.report(std::mem::take(&mut closed)).await;
        }
    }

    /// Waits for the clips' energy, keeps their reports, and publishes them.
    async fn report(&self, closed: Vec<ClosedClip>) {
        let mut measured = Vec::with_capacity(closed.len());
        for clip in closed {
            measured.push(clip.measured().await);
        }
        let (board, meta) = (Arc::clone(&self.board), self.meta());
        let kept = tokio::task::spawn_blocking(move || {
            let report = |clip: MeasuredClip| {
                let mut report = clip.into_report(meta.clone());
                report.round();
                report
            };
            let mut reports: Vec<_> = measured.into_iter().map(report).collect();
            board.outbox().insert(&mut reports, Now::system());
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
                Ok(json) => self.listeners.publish(json),
                Err(error) => {
                    tracing::error!(camera = self.camera, %error, "clip report not written");
                }
            }
            self.board.record_clip(report);
        }
    }

    fn meta(&self) -> ClipMeta {
        ClipMeta {
            node: self.board.node().to_owned(),
            camera: self.camera.clone(),
            policy: self.board.policy().to_owned(),
            model: self.detector.model_name().to_owned(),
            provider: self.detector.provider().as_str().to_owned(),
        }
    }
}
