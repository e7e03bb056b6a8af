//! The drawn frames of one camera that wait, and what came of those that do not.

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

/// Most drawn frames of a camera that wait: each holds its encoded picture.
const MOST_WAITING: usize = 2;

/// A drawn frame that was missed, with that many boxes shown on it.
fn missed(shown: usize) -> AuditReport {
    let mut count = AuditReport::default();
    count.sums.add_missed(shown);
    count
}

/// A frame that was drawn, to run the detector on.
#[derive(Clone, Debug)]
pub(crate) struct DrawnFrame {
    /// The picture, still encoded.
    pub picture: EncodedPicture,
    /// The boxes that were published for it.
    pub shown: Vec<OutputBox>,
}

/// One camera's audit, shared between its loop and the task that runs the detector. The loop only leaves frames here.
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
    /// The number of boxes that were shown on the frame that is being compared.
    comparing: Option<usize>,
}

impl CameraAudit {
    /// For the camera of `board`.
    pub(crate) fn new(config: AuditConfig, board: Arc<CameraBoard>) -> Self {
        Self {
            draw: config.draw(),
            share: config.share,
            board,
            state: Mutex::default(),
            came: Notify::new(),
        }
    }

    /// Share of the skipped frames that is drawn; `None` without an audit.
    pub(crate) fn share(&self) -> Option<f64> {
        (!self.draw.is_off()).then_some(self.share)
    }

    /// Says whether the frame with this number is drawn.
    pub(crate) const fn draws(&self, frame: u64) -> bool {
        self.draw.draw(frame)
    }

    /// Leaves a drawn frame to be looked at. Where too many wait already, it is missed.
    pub(crate) fn offer(&self, frame: DrawnFrame) {
        let mut state = self.state.lock();
        if state.waiting.len() >= MOST_WAITING {
            return self.board.record_audit(&missed(frame.shown.len()));
        }
        state.waiting.push_back(frame);
        drop(state);
        self.came.notify_one();
    }

    /// The next frame to look at.
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

    /// Counts the result of the current frame; `None` when the detector did not run on it in time. A frame that was given up
    /// meanwhile is counted already.
    pub(crate) fn done(&self, found: Option<AuditReport>) {
        let mut state = self.state.lock();
        if let Some(shown) = state.comparing.take() {
            let found = found.unwrap_or_else(|| missed(shown));
            self.board.record_audit(&found);
        }
    }

    /// Gives up the current frame and those that wait: the camera's last clip ends, and all that was drawn must be in it.
    pub(crate) fn give_up(&self) {
        let mut state = self.state.lock();
        let waiting = std::mem::take(&mut state.waiting);
        let waiting = waiting.iter().map(|frame| frame.shown.len());
        for shown in state.comparing.take().into_iter().chain(waiting) {
            self.board.record_audit(&missed(shown));
        }
    }
}
