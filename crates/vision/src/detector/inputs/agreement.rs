//! Whether a model finds the same at two sizes of its input.

use super::Choice;
use albireo_core::detection::Detection;
use std::fmt;

/// Pictures in which something is found that are compared before the smaller input is used.
const PICTURES: u32 = 10;

/// Pictures that are compared at most: on a road that stays empty, nothing has told against the smaller input by then.
const MOST_PICTURES: u32 = 100;

/// The share of sure boxes that must be found at both sizes. A far object flickers around the limit of confidence at
/// either size; a graph that is wrong at another size loses most boxes or moves them.
const LEAST_SHARE: f64 = 0.9;

/// The overlap of two boxes of one object.
const LEAST_OVERLAP: f64 = 0.5;

/// A box is sure from here on, or from the configured confidence if that is higher.
const SURE: f64 = 0.3;

/// Boxes of the same pictures at two sizes of the input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Compared pictures.
    pub pictures: u32,
    /// Pictures in which either found a sure box.
    pub occupied: u32,
    /// Sure boxes of both.
    pub boxes: u32,
    /// Those that the other found as well, perhaps less surely.
    pub paired: u32,
}

impl Agreement {
    /// The least confidence of boxes to compare, where a node reports those of `confidence`.
    pub(crate) fn least_confidence(confidence: f64) -> f64 {
        confidence.max(SURE) / 2.0
    }

    /// Compares the boxes of one picture; both are of at least half the confidence of a sure box.
    pub(crate) fn of(one: &[Detection], other: &[Detection], confidence: f64) -> Self {
        let sure = confidence.max(SURE);
        let mut agreement = Self {
            pictures: 1,
            ..Self::default()
        };
        for (from, to) in [(one, other), (other, one)] {
            for found in from.iter().filter(|found| found.confidence >= sure) {
                let is_same = |there: &Detection| {
                    let overlap = there.bounding_box.intersection_over_union(found.bounding_box);
                    there.class == found.class && overlap >= LEAST_OVERLAP
                };
                agreement.boxes += 1;
                agreement.paired += u32::from(to.iter().any(is_same));
            }
        }
        agreement.occupied = u32::from(agreement.boxes > 0);
        agreement
    }

    pub(super) fn plus(self, other: Self) -> Self {
        Self {
            pictures: self.pictures + other.pictures,
            occupied: self.occupied + other.occupied,
            boxes: self.boxes + other.boxes,
            paired: self.paired + other.paired,
        }
    }

    /// The choice that this much evidence allows.
    pub(super) fn decided(self) -> Choice {
        if self.occupied < PICTURES && self.pictures < MOST_PICTURES {
            return Choice::Comparing(self);
        }
        if f64::from(self.paired) >= LEAST_SHARE * f64::from(self.boxes) {
            Choice::Smallest(self)
        } else {
            Choice::Largest(format!(
                "the model finds something else at the smallest input ({self})"
            ))
        }
    }
}

impl fmt::Display for Agreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            pictures,
            boxes,
            paired,
            ..
        } = self;
        let plural = if *pictures == 1 { "" } else { "s" };
        write!(
            f,
            "{paired} of {boxes} boxes of both in {pictures} picture{plural}"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::detection::ClassId;
    use albireo_core::geometry::BoundingBox;

    fn found(center_x: f64, class: u16, confidence: f64) -> Detection {
        Detection {
            bounding_box: BoundingBox::new(center_x, 0.5, 0.1, 0.1),
            class: ClassId(class),
            confidence,
        }
    }

    #[test]
    fn a_sure_box_pairs_with_a_less_sure_one_in_its_place_and_of_its_class_only() {
        let [car, bus] = [2, 5];
        for (other, boxes, paired) in [
            (found(0.5, car, 0.3), 1, 1),
            (found(0.51, car, 0.9), 2, 2),
            (found(0.5, bus, 0.9), 2, 0),
            (found(0.6, car, 0.9), 2, 0),
        ] {
            let one = [found(0.5, car, 0.6)];
            let agreement = Agreement::of(&one, &[other], 0.5);
            assert_eq!(agreement.paired, paired, "{other:?}");
            assert_eq!(agreement.boxes, boxes, "{other:?}");
        }
    }

    /// The choice after so many pictures with a box at both sizes, with a box at one size, and without a box.
    fn after(agreeing: u32, differing: u32, empty: u32) -> Choice {
        let car = [found(0.5, 2, 0.9)];
        let mut agreement = Agreement::default();
        for (count, one, other) in [
            (agreeing, &car[..], &car[..]),
            (differing, &car, &[]),
            (empty, &[], &[]),
        ] {
            for _ in 0..count {
                agreement = agreement.plus(Agreement::of(one, other, 0.5));
            }
        }
        agreement.decided()
    }

    #[test]
    fn the_smaller_input_is_used_after_ten_occupied_pictures_that_agree_or_a_hundred_empty_ones() {
        for (agreeing, differing, empty) in
            [(10, 0, 0), (10, 0, 50), (9, 1, 0), (0, 0, 100), (3, 0, 97)]
        {
            let choice = after(agreeing, differing, empty);
            assert!(matches!(choice, Choice::Smallest(_)), "{choice:?}");
        }
    }

    #[test]
    fn fewer_pictures_decide_nothing_whether_they_agree_or_not() {
        for (agreeing, differing, empty) in [(0, 0, 0), (9, 0, 50), (0, 9, 0), (0, 0, 99)] {
            let choice = after(agreeing, differing, empty);
            assert!(matches!(choice, Choice::Comparing(_)), "{choice:?}");
        }
    }

    #[test]
    fn the_largest_input_stays_if_many_boxes_differ() {
        for (agreeing, differing, empty) in [(5, 5, 0), (0, 10, 0), (0, 1, 99)] {
            let choice = after(agreeing, differing, empty);
            assert!(matches!(choice, Choice::Largest(_)), "{choice:?}");
        }
    }
}
