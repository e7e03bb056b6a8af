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
use albireo_wire::{AuditReport, DetectionsMessage};
use futures_util::future::BoxFuture;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;

/// The maximum number of drawn frames per camera that are being examined or wait: each holds its encoded picture.
const MOST_DRAWN: usize = 3;

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
    /// An audit without results; `None` without an audit.
    pub(crate) fn report(self) -> Option<AuditReport> {
        if self.share > 0.0 {
            Some(AuditReport {
                share: self.share,
                ..AuditReport::default()
            })
        } else {
            None
        }
    }

    /// Creates the draw of one camera. Each call returns a different one: frames are counted from 0 at every start, and
    /// a camera that always starts at the same place must not have the same frames drawn each time.
    fn draw(self) -> AuditDraw {
        AuditDraw::new(
            self.share,
            RandomState::new().hash_one(self.share.to_bits()),
        )
    }
}

/// The result of a drawn frame; `None` if the detector has no time for it or its picture is broken.
pub(crate) type Examination = BoxFuture<'static, Option<AuditReport>>;

/// An examination that waits or runs, and the number of boxes that were published for its frame.
struct DrawnFrame {
    shown: usize,
    examination: Examination,
}

type Examine = dyn Fn(EncodedPicture, Vec<OutputBox>, Arc<DetectionsMessage>) -> Examination + Send;

/// One camera's audit: part of the camera's loop. Every drawn frame is counted once, as compared or as missed.
pub(crate) struct CameraAudit {
    draw: AuditDraw,
    board: Arc<CameraBoard>,
    /// Examines a picture, for which these boxes were published in this message.
    examine: Box<Examine>,
    /// The first is being examined.
    drawn: VecDeque<DrawnFrame>,
}

impl CameraAudit {
    /// Creates the audit of the camera of `board`.
    pub(crate) fn new(
        config: AuditConfig,
        board: Arc<CameraBoard>,
        examine: impl Fn(EncodedPicture, Vec<OutputBox>, Arc<DetectionsMessage>) -> Examination
        + Send
        + 'static,
    ) -> Self {
        Self {
            draw: config.draw(),
            board,
            examine: Box::new(examine),
            drawn: VecDeque::new(),
        }
    }

    /// Adds the frame with this number, for which the boxes `shown` were published in `answer`, if it is drawn. If too many
    /// are waiting, it counts as missed.
    pub(crate) fn offer(
        &mut self,
        frame: u64,
        picture: &EncodedPicture,
        shown: &[OutputBox],
        answer: &Arc<DetectionsMessage>,
    ) {
        if !self.draw.draw(frame) {
            return;
        }
        if self.drawn.len() == MOST_DRAWN {
            return self.miss(shown.len());
        }
        let examination = (self.examine)(picture.clone(), shown.to_vec(), Arc::clone(answer));
        self.drawn.push_back(DrawnFrame {
            shown: shown.len(),
            examination,
        });
    }

    /// Examines the drawn frames one after the other, and waits forever if there are none. Cancel safe: the next call
    /// continues.
    pub(crate) async fn run(&mut self) {
        while let Some(frame) = self.drawn.front_mut() {
            let shown = frame.shown;
            let examination = &mut frame.examination;
            let found = examination.await;
            self.drawn.pop_front();
            match found {
                Some(found) => self.board.record_audit(&found),
                None => self.miss(shown),
            }
        }
        std::future::pending().await
    }

    /// Gives up the current and the waiting frames: the camera's last clip ends and must include all drawn frames.
    pub(crate) fn give_up(&mut self) {
        for frame in std::mem::take(&mut self.drawn) {
            self.miss(frame.shown);
        }
    }

    /// Counts a missed frame with that many published boxes.
    fn miss(&self, shown: usize) {
        let mut missed = AuditReport::default();
        missed.sums.add_missed(shown);
        self.board.record_audit(&missed);
    }
}
