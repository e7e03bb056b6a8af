use super::*;
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

fn truth(corners: Corners) -> ScoredBox {
    scored(corners, 1.0)
}

fn pooled(predictions: &[Vec<ScoredBox>], truth: &[Vec<ScoredBox>]) -> Accuracy {
    let area = Interpolation::AllPoints;
    accuracy(predictions, truth, Classes::Pooled, area).expect("there is ground truth")
}

#[test]
fn a_hand_computed_curve_has_the_area_of_its_steps() {
    // Ranked: hit, miss, hit; four boxes to find. Precision 1 at recall 1/4, 2/3 at recall 2/4.
    let truths = vec![
        [0.0, 20.0, 40.0, 60.0]
            .map(|x| truth(square(x, 0.0, 10.0)))
            .to_vec(),
    ];
    let predictions = vec![vec![
        scored(square(0.0, 0.0, 10.0), 0.9),
        scored(square(0.0, 50.0, 10.0), 0.8),
        scored(square(20.0, 0.0, 10.0), 0.7),
    ]];
    let result = pooled(&predictions, &truths);
    assert!((result.ap50 - (1.0 + 2.0 / 3.0) / 4.0).abs() < 1e-15);
    assert!((result.map - result.ap50).abs() < 1e-15);
    assert!((result.precision - 2.0 / 3.0).abs() < 1e-15);
    assert!((result.recall - 0.5).abs() < 1e-15);
    // COCO's levels 0 to 0.25 see precision 1 (26 levels), 0.26 to 0.50 see 2/3 (25 levels).
    let area = Interpolation::Coco101;
    let coco = accuracy(&predictions, &truths, Classes::Pooled, area).unwrap();
    assert!((coco.ap50 - (26.0 + 25.0 * 2.0 / 3.0) / 101.0).abs() < 1e-15);
}

#[test]
fn f1_of_shown_boxes_leaves_faint_ones_out_and_counts_those_at_the_floor() {
    let places = [0.0, 20.0, 40.0, 60.0];
    let truths = vec![places.map(|x| truth(square(x, 0.0, 10.0))).to_vec()];
    let found = |confidences: [f64; 3]| {
        let boxes = places.iter().zip(confidences);
        let boxes = boxes.map(|(x, confidence)| scored(square(*x, 0.0, 10.0), confidence));
        pooled(&[boxes.collect()], &truths).f1_50_shown
    };
    // Two shown and right, of four: 2·2 / (2 + 4).
    assert!((found([0.9, SHOWN_CONFIDENCE, 0.29]) - 2.0 / 3.0).abs() < 1e-15);
    assert_eq!(found([0.2, 0.1, 0.29]), 0.0);
    // A wrong one counts against it: 2·1 / (2 + 4).
    let wrong = vec![vec![
        scored(square(0.0, 0.0, 10.0), 0.9),
        scored(square(0.0, 50.0, 10.0), 0.4),
        scored(square(20.0, 0.0, 10.0), 0.2),
    ]];
    assert!((pooled(&wrong, &truths).f1_50_shown - 1.0 / 3.0).abs() < 1e-15);
}

#[test]
fn the_threshold_itself_counts_as_a_match() {
    // Width 10 against width 5 inside it: IoU exactly one half.
    let truths = vec![vec![truth(square(0.0, 0.0, 10.0))]];
    let half = Corners {
        x1: 0.0,
        y1: 0.0,
        x2: 5.0,
        y2: 10.0,
    };
    let result = pooled(&[vec![scored(half, 0.5)]], &truths);
    assert_eq!(result.ap50, 1.0);
    assert!((result.map - 0.1).abs() < 1e-15);
}

#[test]
fn without_ground_truth_accuracy_is_undefined_and_without_predictions_it_is_zero() {
    let predictions = vec![vec![scored(square(0.0, 0.0, 10.0), 0.9)]];
    let area = Interpolation::AllPoints;
    let nothing = accuracy(&predictions, &[vec![]], Classes::Pooled, area);
    assert_eq!(nothing, None);
    let truths = vec![vec![truth(square(0.0, 0.0, 10.0))]];
    let result = pooled(&[], &truths);
    let figures = [result.ap50, result.precision, result.recall];
    assert_eq!(figures, [0.0; 3]);
}

#[test]
fn separate_classes_do_not_match_each_other_and_are_averaged() {
    let mut cyclist = truth(square(20.0, 0.0, 10.0));
    cyclist.class = ClassId(1);
    let truths = vec![vec![truth(square(0.0, 0.0, 10.0)), cyclist]];
    let predictions = vec![vec![
        scored(square(0.0, 0.0, 10.0), 0.9),
        scored(square(20.0, 0.0, 10.0), 0.8),
    ]];
    assert_eq!(pooled(&predictions, &truths).ap50, 1.0);
    let area = Interpolation::AllPoints;
    let separate = accuracy(&predictions, &truths, Classes::Separate, area).unwrap();
    assert_eq!(separate.ap50, 0.5);
}

/// The definition, without shortcuts.
fn slow_average_precision(
    predictions: &[Vec<ScoredBox>],
    truth: &[Vec<ScoredBox>],
    threshold: f64,
) -> f64 {
    let mut ranked = Vec::new();
    for (frame, boxes) in predictions.iter().enumerate() {
        let mut boxes = boxes.clone();
        boxes.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
        let mut free = vec![true; truth[frame].len()];
        for prediction in boxes {
            let mut best = (threshold, None);
            for (index, candidate) in truth[frame].iter().enumerate() {
                let overlap = prediction
                    .corners
                    .intersection_over_union(candidate.corners);
                let better = overlap > best.0 || (best.1.is_none() && overlap >= best.0);
                if free[index] && better {
                    best = (overlap, Some(index));
                }
            }
            if let Some(index) = best.1 {
                free[index] = false;
            }
            ranked.push((prediction.confidence, best.1.is_some()));
        }
    }
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let total = truth.iter().map(Vec::len).sum::<usize>() as f64;
    let mut curve = vec![(0.0, 0.0)];
    let mut hits = 0.0;
    for (rank, (_, hit)) in ranked.iter().enumerate() {
        hits += if *hit { 1.0 } else { 0.0 };
        curve.push((hits / total, hits / (rank + 1) as f64));
    }
    let mut sum = 0.0;
    for step in 1..curve.len() {
        let best = curve[step..]
            .iter()
            .map(|point| point.1)
            .fold(0.0, f64::max);
        sum += (curve[step].0 - curve[step - 1].0) * best;
    }
    sum
}

fn some_box() -> impl Strategy<Value = Corners> {
    (0..12u8, 0..12u8, 1..9u8, 1..9u8).prop_map(|(x, y, w, h)| Corners {
        x1: f64::from(x),
        y1: f64::from(y),
        x2: f64::from(x + w),
        y2: f64::from(y + h),
    })
}

proptest! {
    #[test]
    fn the_fast_algorithm_equals_the_definition(
        frames in proptest::collection::vec(
            (
                proptest::collection::vec((some_box(), 0..6u8), 0..8),
                proptest::collection::vec(some_box(), 0..8),
            ),
            1..5,
        ),
    ) {
        let predictions: Vec<Vec<ScoredBox>> = frames
            .iter()
            .map(|frame| frame.0.iter().map(|&(b, c)| scored(b, f64::from(c) / 8.0)).collect())
            .collect();
        let truths: Vec<Vec<ScoredBox>> = frames
            .iter()
            .map(|frame| frame.1.iter().map(|&b| truth(b)).collect())
            .collect();
        prop_assume!(truths.iter().any(|frame| !frame.is_empty()));
        let fast = pooled(&predictions, &truths);
        let slow = IOU_THRESHOLDS.map(|t| slow_average_precision(&predictions, &truths, t));
        prop_assert!((fast.ap50 - slow[0]).abs() < 1e-12);
        prop_assert!((fast.map - slow.iter().sum::<f64>() / 10.0).abs() < 1e-12);
    }
}

#[test]
fn boxes_in_an_ignored_region_are_no_false_positives_and_found_objects_there_count() {
    let region = square(100.0, 0.0, 100.0);
    let half_outside = square(60.0, 0.0, 80.0);
    let mostly_outside = square(50.0, 0.0, 80.0);
    let found = vec![
        scored(square(120.0, 10.0, 20.0), 0.9),
        scored(half_outside, 0.8),
        scored(mostly_outside, 0.7),
        scored(square(150.0, 50.0, 40.0), 0.6),
        scored(square(400.0, 50.0, 40.0), 0.5),
    ];
    let truths = vec![vec![truth(square(150.0, 50.0, 40.0))], Vec::new()];
    let later = vec![scored(square(120.0, 10.0, 20.0), 0.9)];
    let judged = outside_ignored(&[found, later], &truths, &[vec![region]]);
    let confidences = |frame: &[ScoredBox]| frame.iter().map(|b| b.confidence).collect::<Vec<_>>();
    assert_eq!(confidences(&judged[0]), [0.7, 0.6, 0.5]);
    // The region belongs to the first frame.
    assert_eq!(confidences(&judged[1]), [0.9]);
}

/// `count` boxes, 20 per frame, each predicted slightly off its place.
fn spread_over_frames(count: usize) -> (Vec<Vec<ScoredBox>>, Vec<Vec<ScoredBox>>) {
    let place = |frame: usize, index: usize| {
        let x = ((frame * 37 + index * 61) % 1200) as f64;
        square(x, ((frame + index * 97) % 640) as f64, 80.0)
    };
    let boxes = |frame: usize| (0..20).map(move |index| (index, place(frame, index)));
    let frames = 0..count / 20;
    let predictions = frames.clone().map(|frame| {
        let off_by = |index: usize| ((frame + index) % 40) as f64;
        boxes(frame)
            .map(|(index, c)| {
                let x1 = c.x1 + off_by(index);
                let x2 = x1 + 80.0;
                let corners = Corners { x1, x2, ..c };
                scored(corners, ((frame * 7 + index) % 101) as f64 / 101.0)
            })
            .collect()
    });
    let truth = frames.map(|frame| boxes(frame).map(|(_, corners)| truth(corners)).collect());
    (predictions.collect(), truth.collect())
}

/// Apart from sorting, the work is in the compared pairs.
#[test]
fn a_million_boxes_need_a_linear_number_of_comparisons() {
    let pairs = [10_000, 100_000, 1_000_000].map(|count| {
        let (predictions, truth) = spread_over_frames(count);
        let matching = Matching::new(&predictions, &truth, None);
        assert_eq!((matching.matched.len(), matching.truths), (count, count));
        let hits = matching.matched.iter().filter(|&&m| m & 1 == 1).count();
        assert!(hits * 2 > count && hits < count, "{hits} of {count}");
        matching.compared
    });
    assert!(pairs[1] < 11 * pairs[0], "{pairs:?}");
    assert!(pairs[2] < 11 * pairs[1], "{pairs:?}");
    // Boxes beside each other are not compared: far fewer than the 20 of a frame.
    assert!(pairs[2] < 5 * 1_000_000, "{pairs:?}");
}
