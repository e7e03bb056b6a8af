//! Measures how late objects are found: from their first frame in view to their first published box.
//!
//! An object that nobody finds is late by its whole life. Without that rule the mean would be lowest for those who find
//! only what is easy.

use super::Classes;
use super::truth::Truth;
use crate::boxes::ScoredBox;
use serde::Serialize;
use std::collections::BTreeMap;

/// An object is in view from the first frame on which its box is this high, pixels.
pub const MIN_HEIGHT: f64 = 20.0;

/// The IoU from which a box shows an object.
const SHOWN_IOU: f64 = 0.5;

/// How late the objects of a clip were found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Newcomers {
    /// The number of objects that come into view.
    pub objects: usize,
    /// The number of these that were never found.
    pub never_found: usize,
    /// Mean delay over all of them, frames.
    pub delay_frames: f64,
}

/// An object that has come into view, with the numbers of frames.
struct InView {
    first: usize,
    last: usize,
    found: Option<usize>,
}

/// Measures the delay of each object of `truth` in `published`, both with one list per frame. A box shows every object
/// that it overlaps by IoU 0.5; of its own class only, if classes are judged separately.
///
/// `None` if no object comes into view, if one has no number, or if there are frames without labels: nobody knows then when
/// an object came.
pub fn newcomers<'a>(
    published: &[Vec<ScoredBox>],
    truth: impl Into<Truth<'a>>,
    classes: Classes,
) -> Option<Newcomers> {
    let truth = truth.into();
    if truth.is_sparse() {
        return None;
    }
    let mut objects: BTreeMap<u64, InView> = BTreeMap::new();
    for (frame, known) in truth.objects.iter().enumerate() {
        for object in known {
            let number = object.object?;
            let is_high = object.corners.y2 - object.corners.y1 >= MIN_HEIGHT;
            if !is_high && !objects.contains_key(&number) {
                continue;
            }
            let in_view = objects.entry(number).or_insert(InView {
                first: frame,
                last: frame,
                found: None,
            });
            in_view.last = frame;
            let shows = |shown: &ScoredBox| {
                (classes == Classes::Pooled || shown.class == object.class)
                    && shown.corners.intersection_over_union(object.corners) >= SHOWN_IOU
            };
            if in_view.found.is_none() && published.get(frame).into_iter().flatten().any(shows) {
                in_view.found = Some(frame);
            }
        }
    }
    if objects.is_empty() {
        return None;
    }
    let mut never_found = 0;
    let mut delay = 0;
    for object in objects.values() {
        match object.found {
            Some(found) => delay += found - object.first,
            None => {
                never_found += 1;
                delay += object.last + 1 - object.first;
            }
        }
    }
    Some(Newcomers {
        objects: objects.len(),
        never_found,
        delay_frames: delay as f64 / objects.len() as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::super::average_precision::tests::{scored, square};
    use super::*;
    use albireo_core::detection::ClassId;

    /// The object `number` as a square of this side.
    fn object(number: u64, side: f64) -> ScoredBox {
        ScoredBox {
            object: Some(number),
            ..scored(square(100.0 * number as f64, 0.0, side), 1.0)
        }
    }

    #[test]
    fn a_delay_runs_from_the_first_high_box_and_a_missed_object_is_late_by_its_life() {
        // Object 1 is too small on the first frame, and found on frame 3; object 2 lives for two frames, unseen.
        let truth = [
            vec![object(1, 19.0)],
            vec![object(1, 20.0), object(2, 40.0)],
            vec![object(1, 24.0), object(2, 40.0)],
            vec![object(1, 28.0)],
            vec![object(1, 30.0)],
        ];
        let mut shown = vec![Vec::new(); 5];
        shown[3] = vec![object(1, 28.0)];
        let late = newcomers(&shown, &truth, Classes::Pooled).unwrap();
        assert_eq!(late.objects, 2);
        assert_eq!(late.never_found, 1);
        assert_eq!(late.delay_frames, (2.0 + 2.0) / 2.0);
        // A box on a frame on which the object is still small does not count: it is not in view yet.
        shown[0] = vec![object(1, 19.0)];
        let again = newcomers(&shown, &truth, Classes::Pooled).unwrap();
        assert_eq!(again, late);
        shown[1] = vec![object(1, 20.0), object(2, 40.0)];
        let at_once = newcomers(&shown, &truth, Classes::Pooled).unwrap();
        assert_eq!(at_once.never_found, 0);
        assert_eq!(at_once.delay_frames, 0.0);
    }

    #[test]
    fn another_class_shows_an_object_only_if_classes_are_pooled() {
        let truth = [vec![object(1, 20.0)]];
        let mut other = object(1, 20.0);
        other.class = ClassId(7);
        let never = |classes| newcomers(&[vec![other]], &truth, classes).unwrap().never_found;
        assert_eq!([never(Classes::Pooled), never(Classes::Separate)], [0, 1]);
    }

    #[test]
    fn without_numbers_or_objects_in_view_there_is_no_figure() {
        let unnumbered = [vec![scored(square(0.0, 0.0, 30.0), 1.0)]];
        for truth in [&unnumbered, &[vec![object(1, 5.0)]], &[vec![]]] {
            assert_eq!(newcomers(&[], truth, Classes::Pooled), None);
        }
    }
}
