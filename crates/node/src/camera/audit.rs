//! The audit of a camera: the idle detector examines a sample of the frames that the policy answered without it, and
//! the published boxes are compared with its results.
//!
//! It changes nothing: a frame is drawn by its number after its answer is published, and the detector's results reach
//! neither the policy nor the screen.

mod examiner;
#[cfg(test)]
mod tests;

pub(crate) use examiner::Examiner;

use crate::state::board::CameraBoard;
use albireo_core::audit::AuditDraw;
use albireo_core::policy::OutputBox;
use albireo_vision::picture::EncodedPicture;
use albireo_wire::AuditReport;
use futures_util::future::BoxFuture;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;

/// The maximum number of waiting drawn frames per camera: each holds its encoded picture.
const MOST_WAITING: usize = 2;

/// The `[audit]` section: the share of skipped frames that is examined afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AuditConfig {
    /// Share of the frames answered without the detector; 0 disables the audit.
    pub share: f64,
}

impl Default for AuditConfig {
    fn default() -> Self {
        Self { share: 0.02 }
    }
}

impl AuditConfig {
    /// Creates the draw of one camera. Each call returns a different one: frames are counted from 0 at every start, and
    /// a camera that always starts at the same place must not have the same frames drawn each time.
    fn draw(self) -> AuditDraw {
        AuditDraw::new(
            self.share,
            RandomState::new().hash_one(self.share.to_bits()),
        )
    }
}

/// A drawn frame for the detector.
#[derive(Clone, Debug)]
pub(crate) struct DrawnFrame {
    /// The encoded picture.
    pub picture: EncodedPicture,
    /// The boxes published for it.
    pub shown: Vec<OutputBox>,
}

/// The result of a drawn frame; `None` if the detector has no time for it or its picture is broken.
pub(crate) type Examination = BoxFuture<'static, Option<AuditReport>>;

/// One camera's audit: part of the camera's loop. Every drawn frame is counted once, as compared or as missed.
pub(crate) struct CameraAudit {
    draw: AuditDraw,
    board: Arc<CameraBoard>,
    examine: Box<dyn Fn(DrawnFrame) -> Examination + Send>,
    waiting: VecDeque<DrawnFrame>,
    /// The number of published boxes of the frame that is being examined, and its result.
    examining: Option<(usize, Examination)>,
}

impl CameraAudit {
    /// Creates the audit of the camera of `board`.
    pub(crate) fn new(
        config: AuditConfig,
        board: Arc<CameraBoard>,
        examine: impl Fn(DrawnFrame) -> Examination + Send + 'static,
    ) -> Self {
        Self {
            draw: config.draw(),
            board,
            examine: Box::new(examine),
            waiting: VecDeque::new(),
            examining: None,
        }
    }

    /// True if the frame with this number is drawn.
    pub(crate) const fn draws(&self, frame: u64) -> bool {
        self.draw.draw(frame)
    }

    /// Adds a drawn frame. If too many are waiting, it counts as missed.
    pub(crate) fn offer(&mut self, frame: DrawnFrame) {
        if self.waiting.len() >= MOST_WAITING {
            return self.miss(frame.shown.len());
        }
        self.waiting.push_back(frame);
    }

    /// Examines the drawn frames one after the other, and waits forever if there are none. Cancel safe: the next call
    /// continues.
    pub(crate) async fn run(&mut self) {
        loop {
            if self.examining.is_none() {
                let next = self.waiting.pop_front();
                self.examining = next.map(|frame| (frame.shown.len(), (self.examine)(frame)));
            }
            let Some((shown, examination)) = &mut self.examining else {
                return std::future::pending().await;
            };
            let (shown, found) = (*shown, examination.await);
            self.examining = None;
            match found {
                Some(found) => self.board.record_audit(&found),
                None => self.miss(shown),
            }
        }
    }

    /// Gives up the current and the waiting frames: the camera's last clip ends and must include all drawn frames.
    pub(crate) fn give_up(&mut self) {
        if let Some((shown, _)) = self.examining.take() {
            self.miss(shown);
        }
        for frame in std::mem::take(&mut self.waiting) {
            self.miss(frame.shown.len());
        }
    }

    /// Counts a missed frame with that many published boxes.
    fn miss(&self, shown: usize) {
        let mut missed = AuditReport::default();
        missed.sums.add_missed(shown);
        self.board.record_audit(&missed);
    }
}
