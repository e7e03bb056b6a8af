//! Which boxes a policy that keeps objects reports, and with what confidence.

use super::{AlbireoSettings, BoxSource, DetectorFrameBoxes, OutputBox, ReportedConfidence};
use crate::detection::Detection;
use crate::objects::{ObjectState, ObjectStates};

/// The rules of reporting, from the settings that Albireo and the baselines share.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reporting {
    boxes: DetectorFrameBoxes,
    confidence: ReportedConfidence,
    decay_floor: f64,
    tentative: bool,
}

impl Reporting {
    /// The rules in `settings`.
    pub(crate) fn of(settings: &AlbireoSettings) -> Self {
        Self {
            boxes: settings.detector_frame_boxes,
            confidence: settings.confidence,
            decay_floor: settings.decay_floor,
            tentative: settings.report_tentative,
        }
    }

    /// Appends the boxes of a frame that `detections` were found in, after `objects` have taken them.
    /// Decayed confidences are relative to the threshold `u`.
    pub(crate) fn detector_frame(
        &self,
        detections: &[Detection],
        objects: &ObjectStates,
        u: f64,
        boxes: &mut Vec<OutputBox>,
    ) {
        let own_boxes = self.boxes == DetectorFrameBoxes::Detector;
        if own_boxes {
            for (detection, sighting) in detections.iter().zip(objects.sightings()) {
                if sighting.usable {
                    boxes.push(OutputBox {
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
        for state in objects.states() {
            let source = match state.since_update {
                0 => BoxSource::Detected,
                _ => BoxSource::Rescued,
            };
            // A tentative object that outlives a miss is kept, not rescued: it has no box.
            let reported = match source {
                BoxSource::Detected => !own_boxes && self.is_reported(state),
                _ => state.confirmed,
            };
            if reported {
                boxes.push(self.filter_box(state, source, u));
            }
        }
    }

    /// Appends the boxes of a frame that the detector did not look at.
    pub(crate) fn predicted(&self, objects: &ObjectStates, u: f64, boxes: &mut Vec<OutputBox>) {
        boxes.extend(
            (objects.states().iter())
                .filter(|state| self.is_reported(state))
                .map(|state| self.filter_box(state, BoxSource::Predicted, u)),
        );
    }

    fn is_reported(&self, state: &ObjectState) -> bool {
        state.confirmed || self.tentative
    }

    fn filter_box(&self, state: &ObjectState, source: BoxSource, u: f64) -> OutputBox {
        let kept = match self.confidence {
            ReportedConfidence::Last => 1.0,
            ReportedConfidence::Decayed => (1.0 - state.filter.tau() / u).max(self.decay_floor),
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
}
