use super::*;
use albireo_core::geometry::Corners;
use proptest::prelude::*;

pub(crate) fn square(x: f64, y: f64, side: f64) -> Corners {
    Corners {
        x1: x,
        y1: y,
        x2: x + side,
        y2: y + side,
    }
}

pub(crate) fn scored(corners: Corners, confidence: f64) -> ScoredBox {
    ScoredBox {
        corners,
        class: ClassId(0),
        confidence,
        object: None,
    }
}

/// A square of ten pixels at the upper edge.
pub(crate) fn at(left: f64, confidence: f64) -> ScoredBox {
    scored(square(left, 0.0, 10.0), confidence)
}

/// Four boxes to find, 20 pixels apart.
fn four() -> Vec<Vec<ScoredBox>> {
    vec![[0.0, 20.0, 40.0, 60.0].map(|left| at(left, 1.0)).to_vec()]
}

/// Three predictions for the four boxes, ranked: hit, miss, hit.
fn hit_miss_hit() -> Vec<Vec<ScoredBox>> {
    vec![vec![at(0.0, 0.9), at(100.0, 0.8), at(20.0, 0.7)]]
}

pub(crate) fn pooled(predictions: &[Vec<ScoredBox>], truth: &[Vec<ScoredBox>]) -> Accuracy {
    let area = Interpolation::AllPoints;
    accuracy(predictions, truth, Classes::Pooled, area).expect("there is ground truth")
}

#[test]
fn a_hand_computed_curve_has_the_area_of_its_steps() {
    // Precision 1 at recall 1/4, 2/3 at recall 2/4.
    let result = pooled(&hit_miss_hit(), &four());
    assert!((result.ap50 - (1.0 + 2.0 / 3.0) / 4.0).abs() < 1e-15);
    assert!((result.map - result.ap50).abs() < 1e-15);
}

#[test]
fn at_cocos_recall_levels_a_hand_computed_curve_has_the_mean_of_its_precisions() {
    // The levels 0 to 0.25 see precision 1 (26 levels), 0.26 to 0.50 see 2/3 (25 levels).
    let area = Interpolation::Coco101;
    let coco = accuracy(&hit_miss_hit(), &four(), Classes::Pooled, area).unwrap();
    assert!((coco.ap50 - (26.0 + 25.0 * 2.0 / 3.0) / 101.0).abs() < 1e-15);
}

#[test]
fn precision_is_the_share_of_the_predictions_and_recall_that_of_the_ground_truth() {
    let result = pooled(&hit_miss_hit(), &four());
    assert!((result.precision - 2.0 / 3.0).abs() < 1e-15);
    assert!((result.recall - 0.5).abs() < 1e-15);
}

/// F1 of the shown of three boxes, with four to find.
fn f1_shown(boxes: [ScoredBox; 3]) -> f64 {
    pooled(&[boxes.to_vec()], &four()).f1_50_shown
}

#[test]
fn f1_of_shown_boxes_leaves_faint_ones_out_and_counts_those_at_the_floor() {
    // Two shown and right, of four: 2·2 / (2 + 4).
    let two_shown = f1_shown([at(0.0, 0.9), at(20.0, SHOWN_CONFIDENCE), at(40.0, 0.29)]);
    assert!((two_shown - 2.0 / 3.0).abs() < 1e-15);
    let none_shown = f1_shown([at(0.0, 0.2), at(20.0, 0.1), at(40.0, 0.29)]);
    assert_eq!(none_shown, 0.0);
}

#[test]
fn a_wrong_shown_box_lowers_f1() {
    // One of two shown is right, of four: 2·1 / (2 + 4).
    let found = f1_shown([at(0.0, 0.9), at(100.0, 0.4), at(20.0, 0.2)]);
    assert!((found - 1.0 / 3.0).abs() < 1e-15);
}

#[test]
fn without_ground_truth_accuracy_is_undefined() {
    let area = Interpolation::AllPoints;
    let nothing = accuracy(&[vec![at(0.0, 0.9)]], &[vec![]], Classes::Pooled, area);
    assert_eq!(nothing, None);
}

#[test]
fn without_predictions_accuracy_is_zero_and_written_without_a_sign() {
    let result = pooled(&[], &[vec![at(0.0, 1.0)]]);
    assert_eq!(result.ap50, 0.0);
    assert_eq!(result.precision, 0.0);
    assert_eq!(result.recall, 0.0);
    assert!(result.ap50.is_sign_positive());
    assert!(result.map.is_sign_positive());
}

#[test]
fn separate_classes_do_not_match_each_other_and_are_averaged() {
    let mut cyclist = at(20.0, 1.0);
    cyclist.class = ClassId(1);
    let truths = vec![vec![at(0.0, 1.0), cyclist]];
    let predictions = vec![vec![at(0.0, 0.9), at(20.0, 0.8)]];
    assert_eq!(pooled(&predictions, &truths).ap50, 1.0);
    let area = Interpolation::AllPoints;
    let separate = accuracy(&predictions, &truths, Classes::Separate, area).unwrap();
    assert_eq!(separate.ap50, 0.5);
}

/// The definition, without shortcuts: each box to find counts with the best precision at its rank or later, or zero.
fn slow_average_precision(
    predictions: &[Vec<ScoredBox>],
    truth: &[Vec<ScoredBox>],
    threshold: f64,
) -> f64 {
    struct Ranked {
        confidence: f64,
        is_hit: bool,
    }
    let mut ranked: Vec<Ranked> = Vec::new();
    for (boxes, objects) in predictions.iter().zip(truth) {
        let mut surest_first = boxes.clone();
        surest_first.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
        let mut free: Vec<Corners> = objects.iter().map(|object| object.corners).collect();
        for found in surest_first {
            let overlap = |index: usize| found.corners.intersection_over_union(free[index]);
            // `max_by` takes the last of equals, which in reverse is the first of the boxes.
            let best = (0..free.len()).rev().max_by(|a, b| overlap(*a).total_cmp(&overlap(*b)));
            let matched = best.filter(|best| overlap(*best) >= threshold);
            ranked.push(Ranked {
                confidence: found.confidence,
                is_hit: matched.is_some(),
            });
            if let Some(index) = matched {
                free.remove(index);
            }
        }
    }
    ranked.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    let hits_until = |rank: usize| ranked[..=rank].iter().filter(|found| found.is_hit).count();
    let precision = |rank: usize| hits_until(rank) as f64 / (rank + 1) as f64;
    let best_from = |rank: usize| (rank..ranked.len()).map(precision).fold(0.0, f64::max);
    let hits = (0..ranked.len()).filter(|rank| ranked[*rank].is_hit);
    let to_find: usize = truth.iter().map(Vec::len).sum();
    hits.map(best_from).sum::<f64>() / to_find as f64
}

fn some_boxes() -> impl Strategy<Value = Vec<ScoredBox>> {
    let corners = (0..12u8, 0..12u8, 1..9u8, 1..9u8).prop_map(|(x, y, width, height)| Corners {
        x1: f64::from(x),
        y1: f64::from(y),
        x2: f64::from(x + width),
        y2: f64::from(y + height),
    });
    let scored =
        (corners, 0..6u8).prop_map(|(corners, eighths)| scored(corners, f64::from(eighths) / 8.0));
    proptest::collection::vec(scored, 0..8)
}

proptest! {
    #[test]
    fn the_fast_algorithm_equals_the_definition(
        frames in proptest::collection::vec((some_boxes(), some_boxes()), 1..5),
    ) {
        let (predictions, mut truths): (Vec<_>, Vec<_>) = frames.into_iter().unzip();
        for object in truths.iter_mut().flatten() {
            object.confidence = 1.0;
        }
        prop_assume!(truths.iter().any(|frame| !frame.is_empty()));
        let fast = pooled(&predictions, &truths);
        let slow = IOU_THRESHOLDS.map(|t| slow_average_precision(&predictions, &truths, t));
        prop_assert!((fast.ap50 - slow[AT_50]).abs() < 1e-12);
        prop_assert!((fast.map - slow.iter().sum::<f64>() / 10.0).abs() < 1e-12);
    }
}

/// Predictions and ground truth of `count` boxes, 20 per frame, each predicted slightly off its place.
fn spread_over_frames(count: usize) -> (Vec<Vec<ScoredBox>>, Vec<Vec<ScoredBox>>) {
    let mut predictions = Vec::new();
    let mut truth = Vec::new();
    for frame in 0..count / 20 {
        let mut found = Vec::new();
        let mut objects = Vec::new();
        for index in 0..20 {
            let x = ((frame * 37 + index * 61) % 1200) as f64;
            let y = ((frame + index * 97) % 640) as f64;
            let off_by = ((frame + index) % 40) as f64;
            let confidence = ((frame * 7 + index) % 101) as f64 / 101.0;
            found.push(scored(square(x + off_by, y, 80.0), confidence));
            objects.push(scored(square(x, y, 80.0), 1.0));
        }
        predictions.push(found);
        truth.push(objects);
    }
    (predictions, truth)
}

/// Matches `count` boxes, and counts the pairs that are compared: apart from sorting, the work is in them.
fn compared_pairs(count: usize) -> usize {
    let (predictions, truth) = spread_over_frames(count);
    let any_class = None;
    let matching = Matching::new(&predictions, (&truth).into(), any_class);
    assert_eq!(matching.outcomes.len(), count);
    assert_eq!(matching.truths, count);
    // Most are near enough to their place, and not all.
    let hits = matching.hits();
    assert!(hits * 2 > count && hits < count, "{hits} of {count}");
    matching.compared
}

#[test]
fn a_million_boxes_need_a_linear_number_of_comparisons() {
    let few = compared_pairs(10_000);
    let more = compared_pairs(100_000);
    let most = compared_pairs(1_000_000);
    assert!(more < 11 * few, "{more} after {few}");
    assert!(most < 11 * more, "{most} after {more}");
    // Boxes beside each other are not compared: far fewer than the 20 of a frame.
    assert!(most < 5 * 1_000_000, "{most}");
}
