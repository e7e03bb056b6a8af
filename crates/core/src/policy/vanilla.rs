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
