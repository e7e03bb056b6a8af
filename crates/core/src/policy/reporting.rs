//! The boxes and confidences reported by a policy that keeps objects.

use super::{AlbireoSettings, BoxSource, DetectorFrameBoxes, OutputBox, ReportedConfidence};
use crate::detection::Detection;
use crate::objects::{ObjectState, ObjectStates};

/// Smallest factor of a decayed confidence (published code).
const DECAY_FLOOR: f64 = 0.1;

impl AlbireoSettings {
    /// Appends the boxes of a frame with `detections`, after `objects` have observed them. Decayed confidences are
    /// relative to the threshold `u`.
    pub(super) fn detector_frame(
        &self,
        detections: &[Detection],
        objects: &ObjectStates,
        u: f64,
        boxes: &mut Vec<OutputBox>,
    ) {
        let own_boxes = self.detector_frame_boxes == DetectorFrameBoxes::Detector;
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
            if source == BoxSource::Rescued || !own_boxes {
                boxes.push(self.filter_box(state, source, u));
            }
        }
    }

    /// Appends the boxes of a frame without the detector.
    pub(super) fn predicted(&self, objects: &ObjectStates, u: f64, boxes: &mut Vec<OutputBox>) {
        let states = objects.states().iter();
        boxes.extend(states.map(|state| self.filter_box(state, BoxSource::Predicted, u)));
    }

    fn filter_box(&self, state: &ObjectState, source: BoxSource, u: f64) -> OutputBox {
        let kept = match self.confidence {
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
}
