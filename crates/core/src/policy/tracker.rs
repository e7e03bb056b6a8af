//! The objects of a policy with Albireo's filter, and the boxes and confidences that it reports. Policies that share
//! them have their own triggers and removal rules.

use super::progress::Progress;
use super::{
    AlbireoSettings, BoxSource, DetectorFrameBoxes, FrameHead, ObjectRecord, Outcome, OutputBox,
    PolicyConfig, PolicyConfigError, ReportedConfidence, ThresholdSpec,
};
use crate::detection::Detection;
use crate::objects::{Missed, ObjectState, ObjectStates};

/// The threshold for decaying confidences under a policy without `u`: the published code has this default for all its
/// baselines.
const DECAY_U: f64 = 3e-4;

/// Smallest factor of a decayed confidence (published code).
const DECAY_FLOOR: f64 = 0.1;

/// The objects, and the boxes of the current frame.
#[derive(Clone, Debug)]
pub(super) struct Tracker {
    pub objects: ObjectStates,
    pub settings: AlbireoSettings,
    /// The uncertainty at which a decayed confidence is lowest: the policy's own threshold `u`, or [`DECAY_U`].
    pub u: f64,
    /// Boxes of a detector frame.
    boxes: Vec<OutputBox>,
}

impl Tracker {
    /// Creates a tracker without objects.
    pub(crate) fn new(settings: AlbireoSettings, u: f64) -> Self {
        Self {
            objects: ObjectStates::new(settings.objects),
            settings,
            u,
            boxes: Vec::new(),
        }
    }

    /// Creates the tracker of a baseline. It has the settings of Albireo under the profile of `config`, so that policies
    /// differ only in their named feature.
    pub(crate) fn from_config(config: &PolicyConfig) -> Self {
        Self::new(AlbireoSettings::of(config.profile), DECAY_U)
    }

    /// Copies the state of `other`, which has the same settings. Allocates only while buffers grow.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.objects.copy_from(&other.objects);
        self.u = other.u;
        self.boxes.clone_from(&other.boxes);
    }

    /// Advances the objects to `frame`, and calls `visit` with each and its uncertainty. Returns the frame's progress.
    #[inline]
    pub(crate) fn begin(
        &mut self,
        frame: FrameHead,
        mut visit: impl FnMut(&ObjectState, f64),
    ) -> Progress {
        self.objects.predict(frame.picture, frame.step.max(1));
        let states = self.objects.states();
        let mut tau_max: Option<f64> = None;
        for state in states {
            let tau = state.filter.tau();
            visit(state, tau);
            tau_max = Some(tau_max.map_or(tau, |most| most.max(tau)));
        }
        Progress {
            tau_max,
            active: states.len(),
            ..Progress::default()
        }
    }

    /// Processes the detections; every detection that matches no object creates one.
    pub(crate) fn observe(
        &mut self,
        detections: &[Detection],
        missed: impl FnMut(&mut ObjectState) -> Missed,
    ) {
        self.objects.observe(detections, missed);
        self.draw(detections);
    }

    /// Replaces the boxes by those of a frame with `detections`, which the objects have observed.
    fn draw(&mut self, detections: &[Detection]) {
        self.boxes.clear();
        let reports_detections = self.settings.detector_frame_boxes == DetectorFrameBoxes::Detector;
        if reports_detections {
            for (detection, sighting) in detections.iter().zip(self.objects.sightings()) {
                if sighting.usable {
                    self.boxes.push(OutputBox {
                        bounding_box: detection.bounding_box,
                        class: detection.class,
                        confidence: detection.confidence,
                        source: BoxSource::Detected,
                        object: sighting.object,
                        confirmed: sighting.confirmed,
                    });
                }
            }
        }
        for state in self.objects.states() {
            let source = match state.since_update {
                0 => BoxSource::Detected,
                _ => BoxSource::Rescued,
            };
            if source == BoxSource::Rescued || !reports_detections {
                self.boxes.push(filter_box(&self.settings, self.u, state, source));
            }
        }
    }

    /// Overwrites `outcome` with the end of a frame.
    pub(crate) fn finish(&self, progress: &Progress, outcome: &mut Outcome) {
        progress.finish(outcome);
        if progress.state.is_skipped() {
            let source = BoxSource::Predicted;
            let predicted = |state| filter_box(&self.settings, self.u, state, source);
            outcome.boxes.extend(self.objects.states().iter().map(predicted));
        } else {
            outcome.boxes.extend_from_slice(&self.boxes);
        }
    }

    /// Calls `visit` with the record of every object.
    pub(crate) fn visit(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        for state in self.objects.states() {
            visit(&ObjectRecord::from(state));
        }
    }
}

/// The box of an object's filter, with the confidence to report.
fn filter_box(
    settings: &AlbireoSettings,
    u: f64,
    state: &ObjectState,
    source: BoxSource,
) -> OutputBox {
    let kept = match settings.confidence {
        ReportedConfidence::Last => 1.0,
        ReportedConfidence::Decayed => (1.0 - state.filter.tau() / u).max(DECAY_FLOOR),
    };
    OutputBox {
        bounding_box: state.filter.bounding_box(),
        class: state.class,
        confidence: state.confidence * kept,
        source,
        object: Some(state.id),
        confirmed: state.confirmed,
    }
}

/// Checks that `spec` allows a number of the table `table`.
pub(super) fn check_setting(
    table: &'static str,
    spec: ThresholdSpec,
    value: f64,
) -> Result<f64, PolicyConfigError> {
    spec.check(value).map_err(|error| PolicyConfigError::Setting {
        table,
        reason: error.to_string(),
    })
}
