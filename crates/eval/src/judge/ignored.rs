//! Leaves out boxes that cannot be judged, because of what the ground truth marks where they are.
//!
//! [`Mark`] has the rules. Those at each IoU threshold, which are COCO's, are part of the matching for average
//! precision; [`without_ignored`] applies them at IoU 0.5 for every other figure.

use super::Classes;
use super::assignment::assign;
use super::frame_matching::{self, IOU_THRESHOLDS};
use super::truth::{Ignored, Mark, Truth};
use crate::boxes::ScoredBox;
use albireo_core::geometry::Corners;
use std::borrow::Cow;

/// The overlap from which a box is taken to be on an object.
const SAME_OBJECT: f64 = IOU_THRESHOLDS[0];

/// Returns `predictions` without those that a [`Mark`] with a fixed threshold leaves out. Those of COCO's marks remain:
/// the matching of average precision decides on them.
pub(super) fn without_fixed<'a>(
    predictions: &'a [Vec<ScoredBox>],
    truth: Truth<'_>,
    classes: Classes,
) -> Cow<'a, [Vec<ScoredBox>]> {
    // Most data marks nothing, and a million boxes need not be copied then.
    if truth.ignored.iter().flatten().all(|ignored| is_of_coco(ignored.mark)) {
        return Cow::Borrowed(predictions);
    }
    let mut judged = Vec::with_capacity(predictions.len());
    for (frame, found) in predictions.iter().enumerate() {
        let excused = excused_boxes(found, truth.objects(frame), truth.ignored(frame), classes);
        judged.push(not_excused(found, &excused));
    }
    Cow::Owned(judged)
}

/// Returns the boxes of a frame that are not `excused`.
fn not_excused(found: &[ScoredBox], excused: &[bool]) -> Vec<ScoredBox> {
    found
        .iter()
        .zip(excused)
        .filter(|(_, excused)| !**excused)
        .map(|(found, _)| *found)
        .collect()
}

/// Returns `predictions` without all that cannot be judged at IoU 0.5.
pub(super) fn without_ignored(
    predictions: &[Vec<ScoredBox>],
    truth: Truth<'_>,
    classes: Classes,
) -> Vec<Vec<ScoredBox>> {
    let mut kept = without_fixed(predictions, truth, classes).into_owned();
    for (frame, found) in kept.iter_mut().enumerate() {
        let ignored = truth.ignored(frame);
        if ignored.iter().any(|ignored| is_of_coco(ignored.mark)) {
            let excused =
                frame_matching::excused_at_50(found, truth.objects(frame), ignored, classes);
            *found = not_excused(found, &excused);
        }
    }
    kept
}

/// True if the mark is applied at each IoU threshold.
pub(super) fn is_of_coco(mark: Mark) -> bool {
    matches!(mark, Mark::Crowd | Mark::Object)
}

/// Tells for each box of a frame whether a mark with a fixed threshold leaves it out.
fn excused_boxes(
    found: &[ScoredBox],
    objects: &[ScoredBox],
    ignored: &[Ignored],
    classes: Classes,
) -> Vec<bool> {
    if ignored.contains(&Ignored::UNLABELLED) {
        return vec![true; found.len()];
    }
    let mut excused = Vec::with_capacity(found.len());
    for one in found {
        let own = one.corners;
        let is_inside = |ignored: &Ignored| {
            ignored.mark == Mark::Region
                && ignored.concerns(one.class)
                && 2.0 * own.shared_area(ignored.corners) >= own.area()
        };
        let is_object = |object: &ScoredBox| {
            are_comparable(object, one, classes)
                && own.intersection_over_union(object.corners) >= SAME_OBJECT
        };
        excused.push(ignored.iter().any(is_inside) && !objects.iter().any(is_object));
    }
    if ignored.iter().any(|ignored| ignored.mark == Mark::Distractor) {
        for index in on_distractors(found, objects, ignored, classes) {
            excused[index] = true;
        }
    }
    excused
}

/// Returns the indices of the boxes that fall to distractors, see [`Mark::Distractor`].
fn on_distractors(
    found: &[ScoredBox],
    objects: &[ScoredBox],
    ignored: &[Ignored],
    classes: Classes,
) -> Vec<usize> {
    let labelled: Vec<&Ignored> = ignored
        .iter()
        .filter(|ignored| matches!(ignored.mark, Mark::Distractor | Mark::Unjudged))
        .collect();
    let score = |one: &ScoredBox, place: Corners, is_comparable: bool| {
        let iou = one.corners.intersection_over_union(place);
        if is_comparable && iou >= SAME_OBJECT {
            iou
        } else {
            0.0
        }
    };
    // A row for each object, then one for each of the labelled; a column for each box.
    let mut scores = Vec::new();
    for object in objects {
        for one in found {
            let is_comparable = are_comparable(object, one, classes);
            scores.push(score(one, object.corners, is_comparable));
        }
    }
    for place in &labelled {
        for one in found {
            scores.push(score(one, place.corners, place.concerns(one.class)));
        }
    }
    let mut indices = Vec::new();
    for (row, column) in assign(objects.len() + labelled.len(), found.len(), &scores) {
        let is_distractor =
            row >= objects.len() && labelled[row - objects.len()].mark == Mark::Distractor;
        // The assignment also pairs what does not overlap.
        let overlaps = scores[row * found.len() + column] > 0.0;
        if is_distractor && overlaps {
            indices.push(column);
        }
    }
    indices
}

/// True if a box can be that of an object.
fn are_comparable(object: &ScoredBox, found: &ScoredBox, classes: Classes) -> bool {
    classes == Classes::Pooled || object.class == found.class
}

#[cfg(test)]
mod tests {
    use super::super::average_precision::tests::{at, scored, square};
    use super::super::{Accuracy, Interpolation, accuracy};
    use super::*;
    use albireo_core::detection::ClassId;

    fn marked(corners: Corners, mark: Mark) -> Ignored {
        Ignored {
            corners,
            class: None,
            mark,
        }
    }

    /// The accuracy with all classes pooled.
    fn judged(
        found: &[Vec<ScoredBox>],
        objects: &[Vec<ScoredBox>],
        ignored: &[Vec<Ignored>],
    ) -> Accuracy {
        let truth = Truth { objects, ignored };
        let area = Interpolation::AllPoints;
        accuracy(found, truth, Classes::Pooled, area).expect("there is ground truth")
    }

    /// The confidences of the boxes of a frame that are judged.
    fn kept(found: Vec<ScoredBox>, objects: &[ScoredBox], ignored: Vec<Ignored>) -> Vec<f64> {
        let objects = [objects.to_vec()];
        let ignored = [ignored];
        let truth = Truth {
            objects: &objects,
            ignored: &ignored,
        };
        let kept = without_ignored(&[found], truth, Classes::Pooled);
        kept[0].iter().map(|found| found.confidence).collect()
    }

    #[test]
    fn boxes_in_an_ignored_region_are_no_false_positives_and_found_objects_there_count() {
        let region = marked(square(100.0, 0.0, 100.0), Mark::Region);
        let half_outside = square(60.0, 0.0, 80.0);
        let mostly_outside = square(50.0, 0.0, 80.0);
        let found = vec![
            scored(square(120.0, 10.0, 20.0), 0.9),
            scored(half_outside, 0.8),
            scored(mostly_outside, 0.7),
            scored(square(150.0, 50.0, 40.0), 0.6),
            scored(square(400.0, 50.0, 40.0), 0.5),
        ];
        let object = scored(square(150.0, 50.0, 40.0), 1.0);
        assert_eq!(kept(found, &[object], vec![region]), [0.7, 0.6, 0.5]);
    }

    #[test]
    fn an_ignored_region_of_one_frame_says_nothing_about_the_next() {
        let ignored = [vec![marked(square(100.0, 0.0, 100.0), Mark::Region)]];
        let truth = Truth {
            objects: &[],
            ignored: &ignored,
        };
        let inside = vec![scored(square(120.0, 10.0, 20.0), 0.9)];
        let kept = without_ignored(&[inside.clone(), inside.clone()], truth, Classes::Pooled);
        assert_eq!(kept, [vec![], inside]);
    }

    #[test]
    fn a_frame_that_nobody_labelled_is_not_judged_and_one_without_objects_is() {
        let object = at(0.0, 1.0);
        let found = vec![vec![at(0.0, 0.5)], vec![at(0.0, 0.9)], vec![at(0.0, 0.8)]];
        let objects = [vec![object], vec![], vec![]];
        let all = judged(&found, &objects, &[]);
        let sparse = judged(&found, &objects, &[vec![], vec![Ignored::UNLABELLED]]);
        // Two boxes of higher confidence on frames without objects, or one.
        assert!((all.ap50 - 1.0 / 3.0).abs() < 1e-12, "{all:?}");
        assert!((sparse.ap50 - 0.5).abs() < 1e-12, "{sparse:?}");
        assert_eq!(all.predictions, 3);
        assert_eq!(sparse.predictions, 2);
    }

    #[test]
    fn one_box_falls_to_a_distractor_and_its_double_counts_as_wrong() {
        let distractor = marked(square(0.0, 0.0, 10.0), Mark::Distractor);
        let found = vec![at(0.0, 0.9), at(1.0, 0.8), at(50.0, 0.7)];
        assert_eq!(kept(found, &[at(50.0, 1.0)], vec![distractor]), [0.8, 0.7]);
    }

    #[test]
    fn an_object_takes_its_box_before_a_distractor_at_the_same_place() {
        let distractor = marked(square(0.0, 0.0, 10.0), Mark::Distractor);
        let found = vec![at(0.0, 0.9)];
        assert_eq!(kept(found, &[at(0.0, 1.0)], vec![distractor]), [0.9]);
    }

    #[test]
    fn what_is_labelled_and_not_judged_takes_its_box_from_a_distractor_and_excuses_none() {
        let unjudged = marked(square(0.0, 0.0, 10.0), Mark::Unjudged);
        let beside = marked(square(2.0, 0.0, 10.0), Mark::Distractor);
        let found = vec![at(0.0, 0.9)];
        assert_eq!(kept(found, &[], vec![unjudged, beside]), [0.9]);
    }

    #[test]
    fn a_mark_for_one_class_leaves_boxes_of_others() {
        let cars = Ignored {
            class: Some(ClassId(2)),
            ..marked(square(0.0, 0.0, 10.0), Mark::Distractor)
        };
        let mut car = at(0.0, 0.9);
        car.class = ClassId(2);
        assert_eq!(kept(vec![car], &[], vec![cars]), [0.0; 0]);
        assert_eq!(kept(vec![at(0.0, 0.9)], &[], vec![cars]), [0.9]);
    }

    /// A car, and a long marked place with all four boxes in it, of which the second and the last reach IoU 0.5 with
    /// the car.
    fn car_in_a_long_place(mark: Mark) -> Accuracy {
        let found = [vec![
            at(100.0, 0.99),
            at(2.0, 0.98),
            at(8.0, 0.97),
            at(0.0, 0.5),
        ]];
        let all_boxes = Corners {
            x1: 0.0,
            y1: 0.0,
            x2: 110.0,
            y2: 10.0,
        };
        judged(
            &found,
            &[vec![at(0.0, 1.0)]],
            &[vec![marked(all_boxes, mark)]],
        )
    }

    #[test]
    fn any_number_of_boxes_in_a_crowd_are_left_out() {
        // The surer of the two takes the car; the three others are in the crowd.
        let crowd = car_in_a_long_place(Mark::Crowd);
        assert_eq!(crowd.ap50, 1.0);
        assert_eq!(crowd.precision, 1.0);
        assert_eq!(crowd.predictions, 1);
    }

    #[test]
    fn boxes_inside_an_ignored_object_of_another_size_are_judged() {
        let object = car_in_a_long_place(Mark::Object);
        assert_eq!(object.predictions, 4);
        assert!(object.ap50 < 1.0, "{object:?}");
    }

    #[test]
    fn an_ignored_object_leaves_out_one_box_and_its_double_counts_as_wrong() {
        let doubled = [vec![at(50.0, 0.9), at(50.0, 0.8), at(0.0, 0.7)]];
        let ignored = [vec![marked(square(50.0, 0.0, 10.0), Mark::Object)]];
        let found = judged(&doubled, &[vec![at(0.0, 1.0)]], &ignored);
        assert_eq!(found.ap50, 0.5);
        assert_eq!(found.precision, 0.5);
    }
}
