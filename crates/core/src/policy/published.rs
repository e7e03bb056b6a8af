//! Selects the boxes of a frame that are published.

use super::{BoxSource, OutputBox};

/// Of two boxes of one class with more overlap than this (intersection over union), the more confident one is kept.
const MAX_OVERLAP: f64 = 0.7;

/// The minimum confidence of a published box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MinConfidence {
    detected: f64,
    predicted: f64,
}

impl MinConfidence {
    /// Uses `configured` for all boxes; without it, `detector`, the confidence below which the detector drops boxes,
    /// for detected boxes, and half of it for the others.
    pub fn new(configured: Option<f64>, detector: f64) -> Self {
        Self {
            detected: configured.unwrap_or(detector),
            predicted: configured.unwrap_or(detector / 2.0),
        }
    }

    fn of(self, source: BoxSource) -> f64 {
        match source {
            BoxSource::Detected => self.detected,
            BoxSource::Predicted | BoxSource::Followed | BoxSource::Rescued => self.predicted,
        }
    }

    /// Keeps the boxes to publish, most confident first. The policy's objects do not change.
    pub fn select(self, boxes: &mut Vec<OutputBox>) {
        boxes.retain(|one| one.confidence >= self.of(one.source));
        boxes.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
        let mut kept = 0;
        for at in 0..boxes.len() {
            let (surer, rest) = boxes.split_at_mut(at);
            let (Some(one), Some(surer)) = (rest.first(), surer.get(..kept)) else {
                break;
            };
            let is_double = surer.iter().any(|other| {
                other.class == one.class
                    && other.bounding_box.intersection_over_union(one.bounding_box) > MAX_OVERLAP
            });
            if !is_double {
                boxes.swap(kept, at);
                kept += 1;
            }
        }
        boxes.truncate(kept);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::ClassId;
    use crate::geometry::BoundingBox;

    fn one(x: f64, class: u16, confidence: f64, source: BoxSource) -> OutputBox {
        OutputBox {
            bounding_box: BoundingBox::new(x, 0.5, 0.2, 0.2),
            class: ClassId(class),
            confidence,
            source,
            object: None,
            confirmed: true,
        }
    }

    fn published(configured: Option<f64>, boxes: &[OutputBox]) -> Vec<f64> {
        let mut boxes = boxes.to_vec();
        MinConfidence::new(configured, 0.3).select(&mut boxes);
        boxes.iter().map(|one| one.confidence).collect()
    }

    #[test]
    fn faint_boxes_are_not_published() {
        let boxes = [
            one(0.1, 0, 0.06, BoxSource::Predicted),
            one(0.3, 0, 0.14, BoxSource::Followed),
            one(0.5, 0, 0.15, BoxSource::Rescued),
            one(0.7, 0, 0.29, BoxSource::Detected),
            one(0.9, 0, 0.3, BoxSource::Detected),
        ];
        assert_eq!(published(None, &boxes), [0.3, 0.15]);
        assert_eq!(published(Some(0.0), &boxes).len(), 5);
        assert_eq!(published(Some(0.29), &boxes), [0.3, 0.29]);
        let broken = one(0.5, 0, f64::NAN, BoxSource::Detected);
        assert!(published(Some(0.0), &[broken]).is_empty());
    }

    #[test]
    fn an_object_is_published_once() {
        // Each overlaps the next by about .8, and the second next by .67.
        let row = [
            one(0.50, 0, 0.6, BoxSource::Predicted),
            one(0.52, 0, 0.5, BoxSource::Predicted),
            one(0.54, 0, 0.4, BoxSource::Predicted),
            one(0.54, 1, 0.55, BoxSource::Detected),
        ];
        assert_eq!(published(None, &row), [0.6, 0.55, 0.4]);
        assert_eq!(published(None, &[row[2], row[2]]), [0.4]);
    }
}
