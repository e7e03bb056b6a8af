//! Non-maximum suppression: of boxes of one class that overlap, the most confident stays.

use super::Candidate;
use std::cmp::Ordering;

/// The most candidates that are looked at, the most confident ones: what a broken model or a hostile picture
/// can cost at most. A frame with more real objects than this is not known.
pub const MOST_CANDIDATES: usize = 1000;

/// Sorts `candidates` by confidence and drops each that overlaps a better one of its class by more than
/// `overlap` (intersection over union). Of more than [`MOST_CANDIDATES`] only the best are looked at; returns
/// how many were not. Equal confidences keep their order.
///
/// Takes O(n + m log m + k·m) for n candidates, m of them looked at, k of them kept.
pub fn suppress(candidates: &mut Vec<Candidate>, overlap: f64) -> u64 {
    let over_limit = candidates.len().saturating_sub(MOST_CANDIDATES);
    if over_limit > 0 {
        candidates.select_nth_unstable_by(MOST_CANDIDATES - 1, best_first);
        candidates.truncate(MOST_CANDIDATES);
    }
    candidates.sort_by(best_first);
    let mut kept = 0;
    for index in 0..candidates.len() {
        let candidate = candidates[index];
        let better = &candidates[..kept];
        let is_covered = better.iter().any(|better| {
            better.class == candidate.class
                && better.corners.intersection_over_union(candidate.corners) > overlap
        });
        if !is_covered {
            candidates[kept] = candidate;
            kept += 1;
        }
    }
    candidates.truncate(kept);
    over_limit as u64
}

fn best_first(left: &Candidate, right: &Candidate) -> Ordering {
    right.confidence.total_cmp(&left.confidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::ClassId;
    use crate::geometry::Corners;
    use proptest::prelude::*;

    fn candidate(
        x1: f64,
        y1: f64,
        width: f64,
        height: f64,
        class: u16,
        confidence: f32,
    ) -> Candidate {
        Candidate {
            corners: Corners {
                x1,
                y1,
                x2: x1 + width,
                y2: y1 + height,
            },
            class: ClassId(class),
            confidence,
        }
    }

    fn candidates() -> impl Strategy<Value = Vec<Candidate>> {
        let one = (
            0.0..60.0,
            0.0..60.0,
            1.0..40.0,
            1.0..40.0,
            0_u16..3,
            0_u8..=20,
        )
            .prop_map(|(x, y, width, height, class, confidence)| {
                candidate(x, y, width, height, class, f32::from(confidence) / 20.0)
            });
        prop::collection::vec(one, 0..60)
    }

    /// The textbook: take the best, cross out what it covers, start again.
    fn textbook(mut open: Vec<Candidate>, overlap: f64) -> Vec<Candidate> {
        let mut kept = Vec::new();
        while !open.is_empty() {
            let mut best = 0;
            for index in 1..open.len() {
                if open[index].confidence > open[best].confidence {
                    best = index;
                }
            }
            let best = open.remove(best);
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
            prop_assert_eq!(suppress(&mut fast, overlap), 0);
            prop_assert_eq!(fast, textbook(all, overlap));
        }

        #[test]
        fn what_is_kept_does_not_overlap_and_what_is_dropped_does(
            all in candidates(), overlap in 0.0..1.0
        ) {
            let mut kept = all.clone();
            suppress(&mut kept, overlap);
            let covers = |better: &Candidate, other: &Candidate| {
                better.class == other.class
                    && better.corners.intersection_over_union(other.corners) > overlap
            };
            for (index, one) in kept.iter().enumerate() {
                for better in &kept[..index] {
                    prop_assert!(better.confidence >= one.confidence);
                    prop_assert!(!covers(better, one));
                }
            }
            for one in &all {
                let is_kept = kept.contains(one);
                let is_covered = kept.iter().any(|better| {
                    better.confidence >= one.confidence && covers(better, one)
                });
                prop_assert!(is_kept || is_covered);
            }
            let again = { let mut again = kept.clone(); suppress(&mut again, overlap); again };
            prop_assert_eq!(again, kept);
        }
    }

    #[test]
    fn of_too_many_candidates_the_best_are_looked_at_and_the_rest_counted() {
        // Apart from each other, so that only the limit drops any; the best come last.
        let mut many: Vec<_> = (0..30_000_u32)
            .map(|index| {
                let (x, y) = (f64::from(index % 200) * 2.0, f64::from(index / 200) * 2.0);
                candidate(x, y, 1.0, 1.0, 0, index as f32 / 30_000.0)
            })
            .collect();
        let best = *many.last().unwrap();
        assert_eq!(suppress(&mut many, 0.5), 29_000);
        assert_eq!(many.len(), MOST_CANDIDATES);
        assert_eq!(many[0], best);
        assert!(many.iter().all(|one| one.confidence >= 29_000.0 / 30_000.0));
    }

    #[test]
    fn classes_do_not_suppress_each_other() {
        let mut both = vec![
            candidate(0.0, 0.0, 9.0, 9.0, 0, 0.5),
            candidate(0.0, 0.0, 9.0, 9.0, 1, 0.9),
        ];
        suppress(&mut both, 0.45);
        assert_eq!(both.len(), 2);
    }
}
