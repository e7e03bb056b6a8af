//! The detector on every frame, and nothing else: what all other policies are compared with.

use super::detector_boxes::DetectorBoxes;
use super::{
    CallCause, Evidence, FrameHead, FrameState, Need, Outcome, Policy, PolicyConfig,
    PolicyConfigError,
};

/// The vanilla policy. It keeps no objects and has no knob.
#[derive(Clone, Debug, Default)]
pub struct Vanilla {
    boxes: DetectorBoxes,
    answered: bool,
}

impl Vanilla {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "vanilla";

    pub(super) fn from_config(_: &PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError> {
        Ok(Box::new(Self::default()))
    }
}

impl Policy for Vanilla {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn begin(&mut self, _: FrameHead) -> Need {
        self.boxes.clear();
        self.answered = false;
        Need::Detections
    }

    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        if let Evidence::Detections(detections) = evidence {
            self.answered = true;
            self.boxes.take(detections);
        }
        Need::Nothing
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        let state = match self.answered {
            true => FrameState::I,
            false => FrameState::P,
        };
        outcome.clear(state, !self.answered);
        outcome.cause = Some(CallCause::EveryFrame);
        self.boxes.report(&mut outcome.boxes);
    }

    fn reset(&mut self) {
        self.boxes.clear();
        self.answered = false;
    }

    fn rejected_detections(&self) -> u64 {
        self.boxes.rejected()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::{ClassId, Detection};
    use crate::geometry::{BoundingBox, PictureSize};
    use crate::policy::BoxSource;

    const FRAME: FrameHead = FrameHead {
        index: 0,
        step: 1,
        picture: PictureSize::new(640, 480),
    };

    fn detection(width: f64) -> Detection {
        Detection {
            bounding_box: BoundingBox::new(0.5, 0.5, width, 0.1),
            class: ClassId(3),
            confidence: 0.9,
        }
    }

    #[test]
    fn every_frame_asks_the_detector_and_reports_what_it_found() {
        let mut policy = Vanilla::default();
        let mut outcome = Outcome::default();
        for _ in 0..3 {
            assert_eq!(policy.begin(FRAME), Need::Detections);
            let found = [detection(0.1), detection(f64::NAN), detection(0.2)];
            assert_eq!(policy.answer(Evidence::Detections(&found)), Need::Nothing);
            policy.finish(&mut outcome);
            assert_eq!(outcome.state, FrameState::I);
            assert!(!outcome.degraded);
            assert_eq!(outcome.cause, Some(CallCause::EveryFrame));
            let widths: Vec<_> = outcome.boxes.iter().map(|b| b.bounding_box.width).collect();
            assert_eq!(widths, [0.1, 0.2]);
            assert!(
                outcome
                    .boxes
                    .iter()
                    .all(|b| b.source == BoxSource::Detected)
            );
        }
        assert_eq!(policy.rejected_detections(), 3);
        assert!(policy.set_knob(1e-3).is_err());
    }

    #[test]
    fn without_the_detector_the_frame_is_empty_and_degraded() {
        let mut policy = Vanilla::default();
        let mut outcome = Outcome::default();
        policy.begin(FRAME);
        policy.answer(Evidence::Detections(&[detection(0.1)]));
        policy.finish(&mut outcome);
        policy.begin(FRAME);
        policy.answer(Evidence::Unavailable);
        policy.finish(&mut outcome);
        assert_eq!((outcome.state, outcome.degraded), (FrameState::P, true));
        assert!(outcome.boxes.is_empty());
    }
}
