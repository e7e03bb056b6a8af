//! Non-maximum suppression: of overlapping boxes of one class, the most confident stays.

use super::Candidate;
use std::cmp::Ordering;

/// The maximum number of candidates considered, the most confident ones: limits the cost of a broken model or a hostile
/// picture. More than all anchors of a model with an input of 640x640.
pub(super) const MOST_CANDIDATES: usize = 10_000;

/// The settings of suppression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suppression {
    /// A box that overlaps a better one by more than this (intersection over union) is dropped.
    pub overlap: f64,
    /// True if only boxes of one class suppress each other.
    pub per_class: bool,
    /// The maximum number of boxes kept, the most confident ones.
    pub most: usize,
}

/// Sorts `candidates` by confidence and drops each that overlaps a better one too much. Considers only the best
/// [`MOST_CANDIDATES`] and keeps only `settings.most`; returns the number lost to the first limit, plus one if any were
/// lost to the second. Equal confidences keep their order.
///
/// Takes O(n + m log m + k·m) for n candidates, m of them considered, k of them kept.
pub fn suppress(candidates: &mut Vec<Candidate>, settings: Suppression) -> u64 {
    let mut over_limit = keep_best(candidates, MOST_CANDIDATES);
    let mut kept = 0;
    for index in 0..candidates.len() {
        let candidate = candidates[index];
        let is_covered = candidates[..kept].iter().any(|better| {
            (better.class == candidate.class || !settings.per_class)
                && better.corners.intersection_over_union(candidate.corners) > settings.overlap
        });
        if is_covered {
            continue;
        }
        if kept == settings.most {
            over_limit += 1;
            // Counting the rest would cost too much.
            break;
        }
        candidates[kept] = candidate;
        kept += 1;
    }
    candidates.truncate(kept);
    over_limit
}

/// Sorts `candidates` by confidence and keeps the `most` best; returns the number dropped. Equal confidences keep their
/// order.
pub fn keep_best(candidates: &mut Vec<Candidate>, most: usize) -> u64 {
    let dropped = candidates.len().saturating_sub(most);
    candidates.sort_by(best_first);
    candidates.truncate(most);
    dropped as u64
}

fn best_first(left: &Candidate, right: &Candidate) -> Ordering {
    right.confidence.total_cmp(&left.confidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::head::reading::around;
    use albireo_core::detection::ClassId;
    use proptest::prelude::*;

    /// A candidate whose box has this centre, width and height.
    fn candidate((x, y, width, height): (f64, f64, f64, f64), class: u16, score: f32) -> Candidate {
        Candidate {
            corners: around([x, y, width, height]),
            class: ClassId(class),
            confidence: score,
        }
    }

    fn settings(overlap: f64, most: usize) -> Suppression {
        Suppression {
            overlap,
            per_class: true,
            most,
        }
    }

    fn candidates() -> impl Strategy<Value = Vec<Candidate>> {
        let place = (0.0..60.0, 0.0..60.0, 1.0..40.0, 1.0..40.0);
        let one = (place, 0_u16..3, 0_u8..=20)
            .prop_map(|(place, class, score)| candidate(place, class, f32::from(score) / 20.0));
        prop::collection::vec(one, 0..60)
    }

    /// The textbook: take the best, cross out what it covers, start again.
    fn textbook(mut open: Vec<Candidate>, overlap: f64) -> Vec<Candidate> {
        let mut kept = Vec::new();
        while !open.is_empty() {
            let mut place = 0;
            for index in 1..open.len() {
                if open[index].confidence > open[place].confidence {
                    place = index;
                }
            }
            let best = open.remove(place);
            open.retain(|other| {
                other.class != best.class
                    || best.corners.intersection_over_union(other.corners) <= overlap
            });
            kept.push(best);
        }
        kept
    }

    proptest! {
        #[test]
        fn suppression_equals_the_textbook(all in candidates(), overlap in 0.0..1.0) {
            let mut fast = all.clone();
            let over_limit = suppress(&mut fast, settings(overlap, usize::MAX));
            prop_assert_eq!(over_limit, 0);
            prop_assert_eq!(fast, textbook(all, overlap));
        }
    }

    /// 30,000 candidates, apart from each other, so that only a limit drops any; the best come last.
    fn too_many() -> Vec<Candidate> {
        let one = |index: u32| {
            let x = f64::from(index % 200) * 2.0;
            let y = f64::from(index / 200) * 2.0;
            candidate((x, y, 1.0, 1.0), 0, index as f32 / 30_000.0)
        };
        (0..30_000).map(one).collect()
    }

    #[test]
    fn of_too_many_candidates_the_best_are_considered_and_the_rest_counted() {
        let mut considered = too_many();
        let over_limit = suppress(&mut considered, settings(0.5, usize::MAX));
        assert_eq!(over_limit, 20_000);
        let best: Vec<_> = too_many().into_iter().rev().take(MOST_CANDIDATES).collect();
        assert_eq!(considered, best);
    }

    #[test]
    fn of_too_many_boxes_the_best_are_kept_and_one_is_counted() {
        let mut kept = too_many();
        let over_limit = suppress(&mut kept, settings(0.5, 300));
        assert_eq!(over_limit, 20_000 + 1);
        let best: Vec<_> = too_many().into_iter().rev().take(300).collect();
        assert_eq!(kept, best);
    }
}
