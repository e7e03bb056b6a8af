//! The common part of the baselines with objects: Albireo's filter, matching and reporting. Each has its own trigger
//! and removal rules.

use super::{
    AlbireoSettings, FrameHead, FrameState, ObjectRecord, Outcome, OutputBox, PolicyConfig,
    PolicyConfigError, ThresholdSpec,
};
use crate::detection::Detection;
use crate::objects::{Missed, ObjectState, ObjectStates};

/// The threshold for decaying confidences under a policy without one: the published code has this default for all its
/// baselines.
pub(super) const DECAY_U: f64 = 3e-4;

/// The objects, and the boxes of the current frame.
#[derive(Clone, Debug)]
pub(super) struct Tracker {
    pub objects: ObjectStates,
    settings: AlbireoSettings,
    tau_max: Option<f64>,
    active: usize,
    boxes: Vec<OutputBox>,
}

impl Tracker {
    /// Creates a tracker without objects. It has the settings of Albireo under the profile of `config`, so that policies
    /// differ only in their named feature.
    pub(crate) fn from_config(config: &PolicyConfig) -> Self {
        let settings = AlbireoSettings::of(config.profile);
        Self {
            objects: ObjectStates::new(settings.objects()),
            settings,
            tau_max: None,
            active: 0,
            boxes: Vec::new(),
        }
    }

    /// Advances the objects to `frame`.
    pub(crate) fn begin(&mut self, frame: FrameHead) {
        self.objects.predict(frame.picture, frame.step.max(1));
        let states = self.objects.states();
        self.tau_max = (states.iter())
            .map(|state| state.filter.tau())
            .reduce(f64::max);
        self.active = states.len();
    }

    /// Processes the detections; every detection that matches no object creates one.
    pub(crate) fn observe(
        &mut self,
        detections: &[Detection],
        missed: impl FnMut(&mut ObjectState) -> Missed,
    ) {
        self.objects.observe(detections, missed);
        self.boxes.clear();
        self.settings
            .detector_frame(detections, &self.objects, DECAY_U, &mut self.boxes);
    }

    /// Writes the boxes and uncertainty of a frame in `state` to `outcome`.
    pub(crate) fn finish(&self, state: FrameState, outcome: &mut Outcome) {
        outcome.tau_max = self.tau_max;
        outcome.active = self.active;
        if state.is_skipped() {
            self.settings
                .predicted(&self.objects, DECAY_U, &mut outcome.boxes);
        } else {
            outcome.boxes.extend_from_slice(&self.boxes);
        }
    }

    /// Forgets all objects.
    pub(crate) fn clear(&mut self) {
        self.objects.clear();
        self.tau_max = None;
        self.active = 0;
    }

    /// Calls `visit` with the record of every object.
    pub(crate) fn visit(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        for state in self.objects.states() {
            visit(&ObjectRecord::from(state));
        }
    }
}

/// Checks that `spec` allows a number of the table `table`.
pub(super) fn check_setting(
    table: &'static str,
    spec: ThresholdSpec,
    value: f64,
) -> Result<f64, PolicyConfigError> {
    spec.check(value)
        .map_err(|error| PolicyConfigError::Setting {
            table,
            reason: error.to_string(),
        })
}
