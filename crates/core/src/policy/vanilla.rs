//! The vanilla policy: the detector on every frame, the reference for all other policies.

use super::detector_boxes::DetectorBoxes;
use super::{
    CallCause, Evidence, FrameHead, FrameState, Need, Outcome, Policy, PolicyConfig,
    PolicyConfigError,
};

/// The vanilla policy. It keeps no objects and has no threshold.
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
    use crate::policy::tests::{Run, seen};
    use crate::policy::{BoxSource::Detected, Profile};

    #[test]
    fn every_frame_asks_the_detector_and_reports_what_it_found() {
        let mut run = Run::new("vanilla", Profile::Paper);
        let found = [0.1, f64::NAN, 0.2].map(|x| seen(x, 0.9));
        for _ in 0..3 {
            assert_eq!(run.see(&found), FrameState::I);
            assert_eq!(run.needs, [Need::Detections]);
            assert!(!run.outcome.degraded);
            assert_eq!(run.outcome.cause, Some(CallCause::EveryFrame));
            assert_eq!(run.reported(), [(Detected, 0.1, 0.9), (Detected, 0.2, 0.9)]);
        }
        assert_eq!(run.policy.rejected_detections(), 3);
    }
}
