//! The ERD-only policy (paper, baseline): the empty-scene screen runs on every frame, and the detector on all frames
//! that it does not report as empty.

use crate::policy::detector_boxes::DetectorBoxes;
use crate::policy::progress::Progress;
use crate::policy::{CallCause, Evidence, FrameHead, Need, Outcome, Policy};

/// The screen-only policy. It keeps no objects and has no threshold.
#[derive(Clone, Debug, Default)]
pub(crate) struct ErdOnly {
    boxes: DetectorBoxes,
    progress: Progress,
}

impl ErdOnly {
    /// The name in configuration and reports.
    pub(crate) const NAME: &'static str = "erd-only";
}

impl Policy for ErdOnly {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn begin(&mut self, _: FrameHead) -> Need {
        self.reset();
        self.progress.call(Some(CallCause::NoObjects));
        self.progress.ask(Need::Screen)
    }

    /// Without the screen's verdict the detector runs, and the frame is `I`, not `E+I`.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        match (self.progress.need, evidence) {
            (Need::Screen, evidence) => self.progress.take_verdict(evidence, Need::Detections),
            (Need::Detections, Evidence::Detections(detections)) => {
                self.boxes.take(detections);
                self.progress.detected()
            }
            // Unchanged, so that `finish` detects the missing detections.
            _ => Need::Nothing,
        }
    }

    fn takes_pause(&self) -> bool {
        true
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
