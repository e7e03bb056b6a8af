//! The vanilla policy: the detector on every frame, the reference for all other policies.

use super::detector_boxes::DetectorBoxes;
use super::progress::Progress;
use super::{CallCause, Evidence, FrameHead, Need, Outcome, Policy};

/// The vanilla policy. It keeps no objects and has no threshold.
#[derive(Clone, Debug, Default)]
pub struct Vanilla {
    boxes: DetectorBoxes,
    progress: Progress,
}

impl Vanilla {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "vanilla";
}

impl Policy for Vanilla {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn begin(&mut self, _: FrameHead) -> Need {
        self.reset();
        self.progress.call(Some(CallCause::EveryFrame))
    }

    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        if let Evidence::Detections(detections) = evidence {
            self.boxes.take(detections);
            self.progress.detected();
        }
        Need::Nothing
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        self.boxes.finish(&self.progress, outcome);
    }

    fn reset(&mut self) {
        self.boxes.clear();
        self.progress = Progress::default();
    }

    fn rejected_detections(&self) -> u64 {
        self.boxes.rejected()
    }
}
