//! The ERD-only policy (paper, baseline): the empty-scene screen runs on every frame, and the detector on all frames
//! that it does not report as empty.

use crate::policy::detector_boxes::DetectorBoxes;
use crate::policy::{
    CallCause, Evidence, FrameHead, FrameState, Need, Outcome, Policy, PolicyConfig,
    PolicyConfigError,
};

/// Progress of the current frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum ErdOnlyPhase {
    #[default]
    AwaitsScreen,
    AwaitsDetections {
        screened: bool,
    },
    Decided(FrameState),
}

/// The screen-only policy. It keeps no objects and has no threshold.
#[derive(Clone, Debug, Default)]
pub(crate) struct ErdOnly {
    boxes: DetectorBoxes,
    progress: ErdOnlyPhase,
    /// The reason for the detector call on the current frame.
    cause: Option<CallCause>,
}

impl ErdOnly {
    /// The name in configuration and reports.
    pub(crate) const NAME: &'static str = "erd-only";

    pub(in crate::policy) fn from_config(
        _: &PolicyConfig,
    ) -> Result<Box<dyn Policy>, PolicyConfigError> {
        Ok(Box::new(Self::default()))
    }
}

impl Policy for ErdOnly {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn begin(&mut self, _: FrameHead) -> Need {
        self.boxes.clear();
        self.progress = ErdOnlyPhase::AwaitsScreen;
        self.cause = Some(CallCause::NoObjects);
        Need::Screen
    }

    /// Without the screen's verdict the detector runs, and the frame is `I`, not `E+I`.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        match (self.progress, evidence) {
            (ErdOnlyPhase::AwaitsScreen, Evidence::Screen { empty: true }) => {
                self.progress = ErdOnlyPhase::Decided(FrameState::E);
                self.cause = None;
                Need::Nothing
            }
            (ErdOnlyPhase::AwaitsScreen, evidence) => {
                let screened = matches!(evidence, Evidence::Screen { .. });
                if screened {
                    self.cause = Some(CallCause::Screen);
                }
                self.progress = ErdOnlyPhase::AwaitsDetections { screened };
                Need::Detections
            }
            (ErdOnlyPhase::AwaitsDetections { screened }, Evidence::Detections(detections)) => {
                self.boxes.take(detections);
                self.progress = ErdOnlyPhase::Decided(match screened {
                    true => FrameState::EI,
                    false => FrameState::I,
                });
                Need::Nothing
            }
            // Unchanged, so that `finish` detects the missing detections.
            (ErdOnlyPhase::AwaitsDetections { .. } | ErdOnlyPhase::Decided(_), _) => Need::Nothing,
        }
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        let (state, degraded) = match self.progress {
            ErdOnlyPhase::Decided(state) => (state, false),
            ErdOnlyPhase::AwaitsScreen | ErdOnlyPhase::AwaitsDetections { .. } => {
                (FrameState::P, true)
            }
        };
        outcome.clear(state, degraded);
        outcome.cause = self.cause;
        self.boxes.report(&mut outcome.boxes);
    }

    fn reset(&mut self) {
        self.boxes.clear();
        self.progress = ErdOnlyPhase::AwaitsScreen;
    }

    fn rejected_detections(&self) -> u64 {
        self.boxes.rejected()
    }
}
