//! The waiting drawn frames of one camera, and the counts of missed ones.

use super::AuditConfig;
use crate::state::board::CameraBoard;
use albireo_core::audit::AuditDraw;
use albireo_core::policy::OutputBox;
use albireo_vision::picture::EncodedPicture;
use albireo_wire::AuditReport;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::Arc;
use tokio::sync::Notify;

/// The maximum number of waiting drawn frames per camera: each holds its encoded picture.
const MOST_WAITING: usize = 2;

/// The report of a missed frame with that many published boxes.
fn missed(shown: usize) -> AuditReport {
    let mut count = AuditReport::default();
    count.sums.add_missed(shown);
    count
}

/// A drawn frame for the detector.
#[derive(Clone, Debug)]
pub(crate) struct DrawnFrame {
    /// The encoded picture.
    pub picture: EncodedPicture,
    /// The boxes published for it.
    pub shown: Vec<OutputBox>,
}

/// One camera's audit, shared by its loop and the task that runs the detector. The loop only adds frames.
#[derive(Debug)]
pub(crate) struct CameraAudit {
    draw: AuditDraw,
    share: f64,
    board: Arc<CameraBoard>,
    state: Mutex<State>,
    came: Notify,
}

#[derive(Debug, Default)]
struct State {
    waiting: VecDeque<DrawnFrame>,
    /// The number of published boxes of the frame that is being compared.
    comparing: Option<usize>,
}

impl CameraAudit {
    /// Creates the audit of the camera of `board`.
    pub(crate) fn new(config: AuditConfig, board: Arc<CameraBoard>) -> Self {
        Self {
            draw: config.draw(),
            share: config.share,
            board,
            state: Mutex::default(),
            came: Notify::new(),
        }
    }

    /// The share of skipped frames that is drawn; `None` without an audit.
    pub(crate) fn share(&self) -> Option<f64> {
        (!self.draw.is_off()).then_some(self.share)
    }

    /// True if the frame with this number is drawn.
    pub(crate) const fn draws(&self, frame: u64) -> bool {
        self.draw.draw(frame)
    }

    /// Adds a drawn frame. If too many are waiting, it counts as missed.
    pub(crate) fn offer(&self, frame: DrawnFrame) {
        let mut state = self.state.lock();
        if state.waiting.len() >= MOST_WAITING {
            return self.board.record_audit(&missed(frame.shown.len()));
        }
        state.waiting.push_back(frame);
        drop(state);
        self.came.notify_one();
    }

    /// The next frame to examine.
    pub(crate) async fn next(&self) -> DrawnFrame {
        loop {
            if let Some(frame) = self.take_waiting() {
                return frame;
            }
            self.came.notified().await;
        }
    }

    fn take_waiting(&self) -> Option<DrawnFrame> {
        let mut state = self.state.lock();
        let frame = state.waiting.pop_front()?;
        state.comparing = Some(frame.shown.len());
        Some(frame)
    }

    /// Counts the result of the current frame; `None` if the detector did not run on it in time. A frame that was
    /// already given up is not counted again.
    pub(crate) fn done(&self, found: Option<AuditReport>) {
        let mut state = self.state.lock();
        if let Some(shown) = state.comparing.take() {
            let found = found.unwrap_or_else(|| missed(shown));
            self.board.record_audit(&found);
        }
    }

    /// Gives up the current and the waiting frames: the camera's last clip ends and must include all drawn frames.
    pub(crate) fn give_up(&self) {
        let mut state = self.state.lock();
        let waiting = std::mem::take(&mut state.waiting);
        let waiting = waiting.iter().map(|frame| frame.shown.len());
        for shown in state.comparing.take().into_iter().chain(waiting) {
            self.board.record_audit(&missed(shown));
        }
    }
}
