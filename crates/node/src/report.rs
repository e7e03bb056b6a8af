//! From closed clips to published reports. Each camera's loop keeps its accounts; behind them a
//! task adds the energy, publishes the report, and keeps what nobody has taken yet.

use super::board::Board;
use super::intake::DropCounts;
use super::spool::Spool;
use crate::clip::{
    CameraShare, ClipMeta, ClipTracker, ClosedClip, FrameArrival, FrameResult, clip_energy,
};
use crate::detector::DetectorHandle;
use crate::power::PowerHandle;
use albireo_wire::ClipReport;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::mpsc;
use tokio::time::Instant;
use zenoh::bytes::Encoding;
use zenoh_ext::AdvancedPublisher;

/// Keeps one camera's books in its loop and hands closed clips to the camera's [`Reporter`].
#[derive(Debug)]
pub(crate) struct ClipAccounts {
    books: ClipTracker,
    share: CameraShare,
    ledger: Arc<DropCounts>,
    closed: mpsc::UnboundedSender<ClosedClip>,
}

impl ClipAccounts {
    /// Accounts with empty books, and the end a [`Reporter`] takes closed clips from.
    pub(crate) fn new(
        books: ClipTracker,
        share: CameraShare,
        ledger: Arc<DropCounts>,
    ) -> (Self, mpsc::UnboundedReceiver<ClosedClip>) {
        // Unbounded, because a clip is some kilobytes every some seconds and must not be lost; the
        // reporter's own waiting is bounded.
        let (closed, clips) = mpsc::unbounded_channel();
        let accounts = Self {
            books,
            share,
            ledger,
            closed,
        };
        (accounts, clips)
    }

    /// Takes note of a frame about to be processed and gives the clip it belongs to.
    pub(crate) fn arrive(&mut self, frame: &FrameArrival<'_>) -> Arc<str> {
        self.share.frame(frame.arrival);
        // What was dropped before this frame belongs to the clip that was open then.
        self.books.dropped(&self.ledger.take());
        let closed = self.books.arrive(frame);
        self.hand_over(closed);
        self.books.clip().map_or_else(|| "".into(), Arc::clone)
    }

    /// Notes that the detector worked for this camera.
    pub(crate) fn detector_ran(&self, start: Instant, end: Instant) {
        self.share.detector(start, end);
    }

    /// Counts the outcome of the frame that arrived last.
    pub(crate) fn count(&mut self, result: &FrameResult) {
        self.books.count(result);
    }

    /// When [`tick`](Self::tick) should be called, should no frame come before.
    pub(crate) fn deadline(&self) -> Option<Instant> {
        self.books.deadline()
    }

    /// Ends the clip whose time is up.
    pub(crate) fn tick(&mut self) {
        self.books.dropped(&self.ledger.take());
        let closed = self.books.tick(Instant::now());
        self.hand_over(closed);
    }

    /// Ends the open clip because the node stops.
    pub(crate) fn shutdown(&mut self) {
        self.books.dropped(&self.ledger.take());
        let closed = self.books.shutdown(Instant::now());
        self.hand_over(closed);
    }

    fn hand_over(&self, closed: Option<ClosedClip>) {
        if let Some(closed) = closed
            && self.closed.send(closed).is_err()
        {
            tracing::error!("a clip ended and nobody reports it");
        }
    }
}

/// Publishes one camera's clip reports.
pub(crate) struct Reporter {
    /// Where reports are shown.
    pub board: Arc<Board>,
    /// The camera's name.
    pub camera: String,
    /// What ran the detector.
    pub detector: DetectorHandle,
    /// Where the energy comes from.
    pub power: PowerHandle,
    /// The camera's share of it.
    pub share: CameraShare,
    /// Numbers the node's reports.
    pub numbers: Arc<AtomicU64>,
    /// Where reports go.
    pub publisher: AdvancedPublisher<'static>,
    /// Where those wait that nobody has taken; `None` without a state directory.
    pub spool: Option<Spool>,
}

impl Reporter {
    /// Reports until the accounts are gone and their last clip is out.
    pub(crate) async fn run(mut self, mut clips: mpsc::UnboundedReceiver<ClosedClip>) {
        let listener = match self.publisher.matching_listener().await {
            Ok(listener) => listener,
            Err(error) => {
                return tracing::error!(camera = self.camera, %error, "clip reports cannot be published");
            }
        };
        self.deliver_waiting().await;
        loop {
            tokio::select! {
                biased;
                closed = clips.recv() => match closed {
                    Some(closed) => self.report(closed).await,
                    None => return,
                },
                Ok(status) = listener.recv_async() => if status.matching() {
                    self.deliver_waiting().await;
                },
            }
        }
    }

    async fn report(&mut self, closed: ClosedClip) {
        let energy = clip_energy(&closed, &self.power, &self.share).await;
        let board = self.power.board(closed.start, closed.end);
        let report = closed.into_report(
            ClipMeta {
                node: self.board.node().to_owned(),
                camera: self.camera.clone(),
                report: self.numbers.fetch_add(1, Ordering::Relaxed),
                policy: self.board.policy().to_owned(),
                model: self.detector.model_name().to_owned(),
                provider: self.detector.provider().as_str().to_owned(),
            },
            energy,
            board,
        );
        tracing::info!(
            camera = self.camera,
            clip = report.clip,
            frames = report.frames,
            skip_rate = report.skip_rate,
            joules = report.energy.joules,
            quality = ?report.energy.quality,
            "clip ended"
        );
        if !self.has_taker().await
            && let Some(spool) = &mut self.spool
            && let Err(error) = spool.keep(&report)
        {
            tracing::error!(camera = self.camera, clip = report.clip, %error, "clip report not kept");
        }
        // Published in any case: the cache serves clients that come late.
        self.publish(&report).await;
        self.board.record_clip(report);
    }

    /// Whether anybody subscribes to the reports now.
    async fn has_taker(&self) -> bool {
        self.publisher
            .matching_status()
            .await
            .is_ok_and(|status| status.matching())
    }

    /// Publishes what waits in the spool, if somebody is there to take it.
    async fn deliver_waiting(&mut self) {
        let Some(spool) = &self.spool else { return };
        if !self.has_taker().await {
            return;
        }
        let files = match spool.waiting() {
            Ok(files) => files,
            Err(error) => {
                return tracing::error!(camera = self.camera, %error, "kept clip reports not read");
            }
        };
        for file in files {
            let delivered = match spool.read(&file) {
                Ok(Some(report)) => {
                    if !self.publish(&report).await {
                        return;
                    }
                    spool.delivered(&file)
                }
                Ok(None) => Ok(()),
                Err(error) => Err(error),
            };
            if let Err(error) = delivered {
                tracing::error!(file = %file.display(), %error, "kept clip report not delivered");
            }
        }
    }

    async fn publish(&self, report: &ClipReport) -> bool {
        let json = match serde_json::to_vec(report) {
            Ok(json) => json,
            Err(error) => {
                tracing::error!(camera = self.camera, %error, "clip report not written");
                return false;
            }
        };
        let sent = self
            .publisher
            .put(json)
            .encoding(Encoding::APPLICATION_JSON)
            .await;
        if let Err(error) = &sent {
            tracing::error!(camera = self.camera, clip = report.clip, %error, "clip report not published");
        }
        sent.is_ok()
    }
}
