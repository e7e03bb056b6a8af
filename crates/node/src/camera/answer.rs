//! Converts a policy's outcome to its message.

use crate::input::Frame;
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{BoxSource, Outcome, OutputBox};
use albireo_wire::{BoxMessage, DetectionsMessage, Latency, VERSION, box_messages, significant};

/// The message for a frame of `clip` with its final answer, without threshold and latency. Its figures are rounded to
/// significant digits: corners to a hundredth of a pixel, confidence to four digits, τ to six. Boxes are clipped to
/// the picture; boxes entirely outside are left out.
pub fn detections_message(
    outcome: &Outcome,
    frame: &Frame,
    clip: &str,
    class_names: &[String],
) -> DetectionsMessage {
    let size = frame.picture.size;
    DetectionsMessage {
        v: VERSION,
        seq: frame.sequence,
        t_ns: frame.time_ns,
        clip: clip.to_owned(),
        state: outcome.state,
        pending: false,
        degraded: outcome.degraded,
        cause: outcome.cause,
        passed: outcome.passed,
        tau_max: outcome.tau_max.map(|tau| significant(tau, 6)),
        threshold: None,
        width: size.width,
        height: size.height,
        boxes: box_messages(&outcome.boxes, size, class_names),
        latency_ms: Latency::default(),
    }
}

/// The detector's own boxes for a picture of that size.
pub(super) fn detected_messages(
    detections: &[Detection],
    size: PictureSize,
    names: &[String],
) -> Vec<BoxMessage> {
    let output = |found: &Detection| OutputBox {
        bounding_box: found.bounding_box,
        class: found.class,
        confidence: found.confidence,
        source: BoxSource::Detected,
        object: None,
        confirmed: false,
    };
    let boxes: Vec<_> = detections.iter().map(output).collect();
    box_messages(&boxes, size, names)
}
