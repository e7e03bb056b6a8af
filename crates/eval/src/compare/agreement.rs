//! Judges a policy's boxes by those of a policy that runs the detector on every frame, and by ground truth.

use crate::boxes::ScoredBox;
use crate::judge::{Classes, Interpolation, Truth, accuracy};
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;
use albireo_wire::DetectionsMessage;
use serde::Serialize;
use std::collections::BTreeMap;

/// The boxes of a clip's frames, by the frame's number in the clip. Frames that were not answered are missing.
pub type Boxes = BTreeMap<u64, Vec<ScoredBox>>;

/// Boxes judged by other boxes: those of a policy that runs the detector on every frame, or ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// Average precision at an intersection over union of 0.5, all classes as one, 0 to 1.
    pub ap50: f64,
    /// Share of the boxes that match one of the others.
    pub precision: f64,
    /// Share of the others that are matched.
    pub recall: f64,
    /// The number of frames that are judged: those that both answered, or all that have ground truth.
    pub frames: u64,
}

/// Numbers class names in the order in which they first appear.
#[derive(Clone, Debug, Default)]
pub struct ClassNumbers(BTreeMap<String, u16>);

impl ClassNumbers {
    /// Converts the boxes of a message to boxes that can be judged, and numbers their classes that are new.
    pub fn boxes(&mut self, message: &DetectionsMessage) -> Vec<ScoredBox> {
        let mut boxes = Vec::new();
        for found in &message.boxes {
            let [x1, y1, x2, y2] = found.corners.map(f64::from);
            boxes.push(ScoredBox {
                corners: Corners { x1, y1, x2, y2 },
                class: self.number(&found.class),
                confidence: f64::from(found.confidence),
                object: None,
            });
        }
        boxes
    }

    /// The number of a class; a name that is new gets the next one.
    fn number(&mut self, name: &str) -> ClassId {
        let next = u16::try_from(self.0.len()).unwrap_or(u16::MAX);
        ClassId(*self.0.entry(name.to_owned()).or_insert(next))
    }
}

/// Judges `boxes` against `reference` over the frames that are in both; `None` if the reference has no box in any of
/// them.
pub fn agreement(boxes: &Boxes, reference: &Boxes) -> Option<Agreement> {
    let mut found = Vec::new();
    let mut truth = Vec::new();
    for (frame, own) in boxes {
        if let Some(expected) = reference.get(frame) {
            found.push(own.clone());
            truth.push(expected.clone());
        }
    }
    let judged = accuracy(&found, &truth, Classes::Pooled, Interpolation::AllPoints)?;
    Some(Agreement {
        ap50: judged.ap50,
        precision: judged.precision,
        recall: judged.recall,
        frames: found.len() as u64,
    })
}

/// Judges the boxes of each frame by ground truth, as a user sees them: a frame that was not answered has no box.
/// `None` if the truth has no object.
pub fn agreement_with_truth(boxes: &[Vec<ScoredBox>], truth: Truth<'_>) -> Option<Agreement> {
    let judged = accuracy(boxes, truth, Classes::Pooled, Interpolation::AllPoints)?;
    Some(Agreement {
        ap50: judged.ap50,
        precision: judged.precision,
        recall: judged.recall,
        frames: boxes.len() as u64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::average_precision::tests::at;

    /// The agreement of boxes with themselves.
    fn full(frames: u64) -> Agreement {
        Agreement {
            ap50: 1.0,
            precision: 1.0,
            recall: 1.0,
            frames,
        }
    }

    fn three_boxes() -> Boxes {
        [
            (0, vec![at(0.0, 0.9), at(50.0, 0.8)]),
            (1, vec![at(0.0, 0.9)]),
        ]
        .into()
    }

    #[test]
    fn identical_boxes_agree_fully() {
        let reference = three_boxes();
        let same = agreement(&reference, &reference).unwrap();
        assert_eq!(same, full(2));
    }

    #[test]
    fn a_box_that_matches_none_costs_precision_and_a_missed_one_recall() {
        // One of the two matches, and two of the three are missed.
        let other: Boxes = [(0, vec![at(1.0, 0.9), at(80.0, 0.5)]), (1, vec![])].into();
        let found = agreement(&other, &three_boxes()).unwrap();
        assert_eq!(found.precision, 0.5);
        assert!((found.recall - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(found.frames, 2);
    }

    #[test]
    fn only_frames_that_both_answered_are_compared() {
        let reference: Boxes = [(0, vec![at(0.0, 0.9)]), (1, vec![at(0.0, 0.9)])].into();
        let other: Boxes = [(1, vec![at(0.0, 0.9)]), (2, vec![at(0.0, 0.9)])].into();
        let found = agreement(&other, &reference).unwrap();
        assert_eq!(found, full(1));
    }

    #[test]
    fn an_object_of_a_frame_without_an_answer_is_missed() {
        let objects = [vec![at(0.0, 0.9)], vec![at(0.0, 0.9)]];
        let truth = Truth {
            objects: &objects,
            ignored: &[],
        };
        let found = agreement_with_truth(&[vec![at(0.0, 0.9)], vec![]], truth).unwrap();
        assert_eq!(found.precision, 1.0);
        assert_eq!(found.recall, 0.5);
        assert_eq!(found.frames, 2);
    }

    #[test]
    fn a_reference_without_boxes_gives_no_figure() {
        let empty: Boxes = [(0, vec![])].into();
        assert_eq!(agreement(&empty, &empty), None);
        assert_eq!(agreement(&Boxes::new(), &Boxes::new()), None);
    }
}
