//! What a receiver tells of its camera: frames that are not processed, and the newest picture.

use super::arrivals::Arrivals;
use crate::frame::LatestFrame;
use albireo_wire::{DropKind, DroppedFrames};
use parking_lot::Mutex;
use std::fmt::Display;
use std::sync::Arc;

/// Counts the unprocessed frames of one camera, and keeps its newest picture.
#[derive(Debug, Default)]
pub struct InputCounter {
    counts: Mutex<InputCounts>,
    /// Counts everything that the camera sends.
    pub(crate) arrivals: Arc<Arrivals>,
    latest: Mutex<Option<Arc<LatestFrame>>>,
}

#[derive(Debug, Default)]
struct InputCounts {
    /// Unprocessed frames since the start.
    dropped: DroppedFrames,
    /// Those that are in no clip yet.
    unreported: DroppedFrames,
    unusable: Unusable,
}

/// The frames in a row, up to now, that were no usable picture, and the fault of the last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Unusable {
    /// Their number; 0 after a frame that was answered.
    pub frames: u64,
    /// The fault of the last.
    pub fault: Arc<str>,
}

impl InputCounter {
    /// Counts `number` frames that will not be processed, for that `reason`.
    pub fn count(&self, kind: DropKind, number: u64, reason: &dyn Display) {
        let mut counts = self.counts.lock();
        counts.dropped.add(kind, number);
        counts.unreported.add(kind, number);
        if kind.is_unusable() {
            counts.unusable.frames += 1;
            counts.unusable.fault = reason.to_string().into();
        }
    }

    /// Notes that a frame was answered: no unusable frames are in a row any more.
    pub(crate) fn answered(&self) {
        self.counts.lock().unusable.frames = 0;
    }

    /// The unprocessed frames since the start, and the last ones in a row that were unusable.
    pub(crate) fn counts(&self) -> (DroppedFrames, Unusable) {
        let counts = self.counts.lock();
        (counts.dropped, counts.unusable.clone())
    }

    /// Takes the unprocessed frames since the last call, for the open clip.
    pub(crate) fn take_unreported(&self) -> DroppedFrames {
        std::mem::take(&mut self.counts.lock().unreported)
    }

    /// Keeps the newest picture for viewers.
    pub fn set_latest_frame(&self, frame: LatestFrame) {
        *self.latest.lock() = Some(Arc::new(frame));
    }

    /// The newest picture.
    pub(crate) fn latest_frame(&self) -> Option<Arc<LatestFrame>> {
        self.latest.lock().clone()
    }
}
