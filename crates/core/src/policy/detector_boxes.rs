//! The boxes of the detector's last answer, as reported by policies that keep no objects.

use super::progress::Progress;
use super::{BoxSource, Outcome, OutputBox};
use crate::detection::Detection;
use crate::objects::is_usable;

/// The boxes of the last answer. The buffer is reused between frames.
#[derive(Clone, Debug, Default)]
pub(super) struct DetectorBoxes {
    boxes: Vec<OutputBox>,
    rejected: u64,
}

impl DetectorBoxes {
    /// Replaces the boxes by those of an answer; counts and drops unusable detections.
    pub(crate) fn take(&mut self, detections: &[Detection]) {
        self.boxes.clear();
        for detection in detections {
            if is_usable(detection) {
                self.boxes.push(OutputBox {
                    bounding_box: detection.bounding_box,
                    class: detection.class,
                    confidence: detection.confidence,
                    source: BoxSource::Detected,
                    object: None,
                    confirmed: false,
                });
            } else {
                self.rejected = self.rejected.saturating_add(1);
            }
        }
    }

    /// Overwrites `outcome` with the end of a frame. Without an answer of the detector in this frame, the boxes are those
    /// of an earlier one.
    pub(crate) fn finish(&self, progress: &Progress, outcome: &mut Outcome) {
        progress.finish(outcome);
        outcome.boxes.extend_from_slice(&self.boxes);
        if progress.state.is_skipped() {
            for repeated in &mut outcome.boxes {
                repeated.source = BoxSource::Predicted;
            }
        }
    }

    /// Forgets the boxes; keeps the count of rejected detections.
    pub(crate) fn clear(&mut self) {
        self.boxes.clear();
    }

    /// Returns the number of detections rejected so far.
    pub(crate) fn rejected(&self) -> u64 {
        self.rejected
    }
}
