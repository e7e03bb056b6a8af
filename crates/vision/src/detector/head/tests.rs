//! The heads on handmade tensors. `tests/head_fixtures.rs` compares all but YOLOX and FastestDet with the vendors' code.

use super::*;
use crate::onnx::{ElementType, Metadata, TensorSpec};
use proptest::prelude::*;

mod fitting;
mod writing;

fn spec(name: &str, shape: &[i64]) -> TensorSpec {
    TensorSpec {
        name: name.to_owned(),
        element: ElementType::Float32,
        shape: shape.to_vec(),
    }
}

fn signature(input: &[i64], outputs: &[(&str, &[i64])]) -> Signature {
    Signature {
        inputs: vec![spec("images", input)],
        outputs: outputs.iter().map(|(name, shape)| spec(name, shape)).collect(),
        metadata: Metadata::default(),
    }
}

pub(in crate::detector) fn bound(
    name: HeadName,
    input: &[i64],
    outputs: &[(&str, &[i64])],
) -> Head {
    let signature = signature(input, outputs);
    let input = signature.picture_input(None).unwrap();
    bind(&name.into(), &signature, input, HeadOverrides::default()).unwrap()
}

type Shapes = Vec<Vec<i64>>;

/// The smallest head of each kind that still has several boxes, with the shapes of its outputs: at an input of 64x32 and
/// with two classes, so that a swapped axis has another length and does not pass. The end-to-end head has no axis of
/// classes.
fn heads() -> Vec<(Head, Shapes)> {
    let input = [1, 3, 32, 64];
    let detr: [(&str, &[i64]); 2] = [("labels", &[1, 4, 2]), ("dets", &[1, 4, 4])];
    let one = |name, shape: &[i64]| {
        let head = bound(name, &input, &[("output", shape)]);
        (head, vec![shape.to_vec()])
    };
    let two = detr.map(|(_, shape)| shape.to_vec()).to_vec();
    vec![
        one(HeadName::Yolo, &[1, 6, 42]),
        one(HeadName::EndToEnd, &[1, 5, 6]),
        one(HeadName::Yolox, &[1, 42, 7]),
        one(HeadName::FastestDet, &[1, 7, 2, 4]),
        (bound(HeadName::Detr, &input, &detr), two),
    ]
}

fn read(head: &Head, outputs: &[(&[i64], &[f32])]) -> (u64, Vec<Candidate>) {
    let views: Vec<_> =
        outputs.iter().map(|&(shape, values)| TensorView { shape, values }).collect();
    let mut candidates = Vec::new();
    let rejected = head.read(&views, 0.5, &mut candidates).unwrap();
    (rejected, candidates)
}

/// What one of the [`heads`] with one output reads if these boxes, each with its number, have these numbers, and all
/// others are 0.
fn read_boxes(name: HeadName, boxes: &[(usize, &[f32])]) -> (u64, Vec<Candidate>) {
    let (head, shapes) = heads().into_iter().find(|(head, _)| head.name == name).unwrap();
    let mut values = vec![0.0; shapes[0].iter().product::<i64>() as usize];
    // These two have the first number of every box, then the second of every box, and so on.
    let boxes_of_channel = match name {
        HeadName::Yolo => Some(42),
        HeadName::FastestDet => Some(8),
        _ => None,
    };
    for (number_of_box, numbers) in boxes {
        for (place, number) in numbers.iter().enumerate() {
            let at = match boxes_of_channel {
                Some(boxes) => place * boxes + number_of_box,
                None => number_of_box * numbers.len() + place,
            };
            values[at] = *number;
        }
    }
    read(&head, &[(&shapes[0], &values)])
}

#[track_caller]
fn assert_candidates(found: &[Candidate], expected: &[([f64; 4], u16, f32)]) {
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (found, (corners, class, confidence)) in found.iter().zip(expected) {
        let Corners { x1, y1, x2, y2 } = found.corners;
        for (found, expected) in [x1, y1, x2, y2].into_iter().zip(corners) {
            assert!((found - expected).abs() < 1e-4, "{found}, not {expected}");
        }
        assert_eq!(found.class, ClassId(*class));
        assert!((found.confidence - confidence).abs() < 1e-6, "{found:?}");
    }
}

#[test]
fn cells_are_suppressed_and_final_boxes_are_not_whether_or_not_the_model_names_their_number() {
    for (rows, overlap) in [(0, false), (300, false), (1001, true), (42, true)] {
        for declared in [rows as i64, -1] {
            let outputs: [(&str, &[i64]); 1] = [("output0", &[1, declared, 6])];
            let head = bound(HeadName::EndToEnd, &[1, 3, 32, 64], &outputs);
            let output = TensorView {
                shape: &[1, rows as i64, 6],
                values: &vec![0.0; rows * 6],
            };
            assert_eq!(
                head.overlaps_in(&[output]),
                overlap,
                "{rows} rows, {declared}"
            );
        }
    }
}

#[test]
fn a_dynamic_number_of_boxes_may_change_from_frame_to_frame() {
    let outputs: [(&str, &[i64]); 1] = [("output0", &[-1, -1, 6])];
    let head = bound(HeadName::EndToEnd, &[1, 3, 32, 64], &outputs);
    for boxes in [0, 1, 7] {
        let output = vec![0.0; boxes * 6];
        let shape = [1, boxes as i64, 6];
        let (rejected, found) = read(&head, &[(&shape, &output)]);
        assert_eq!(rejected, 0, "{boxes} boxes");
        assert!(found.is_empty(), "{boxes} boxes");
    }
}

fn sigmoid(logit: f32) -> f32 {
    1.0 / (1.0 + (-logit).exp())
}

#[test]
fn detr_keeps_the_best_pairs_of_query_and_class_and_no_more_than_there_are_queries() {
    let outputs: [(&str, &[i64]); 2] = [("dets", &[1, 3, 4]), ("labels", &[1, 3, 2])];
    let head = bound(HeadName::Detr, &[1, 3, 100, 200], &outputs);
    let boxes = [
        [0.5, 0.5, 0.5, 0.5],
        [0.25, 0.5, 0.5, 1.0],
        [0.1, 0.1, 0.1, 0.1],
    ];
    // The first query has both classes; of the last, one is below the threshold and one is the fourth best.
    let logits = [[2.0, 0.5], [-3.0, 1.0], [0.2, -0.1]];
    let (rejected, found) = read(
        &head,
        &[
            (&[1, 3, 4], boxes.as_flattened()),
            (&[1, 3, 2], logits.as_flattened()),
        ],
    );
    assert_eq!(rejected, 0);
    assert_candidates(
        &found,
        &[
            ([50.0, 25.0, 150.0, 75.0], 0, sigmoid(2.0)),
            ([0.0, 0.0, 100.0, 100.0], 1, sigmoid(1.0)),
            ([50.0, 25.0, 150.0, 75.0], 1, sigmoid(0.5)),
        ],
    );
}

#[test]
fn detr_takes_a_query_whole_or_not_at_all() {
    let outputs: [(&str, &[i64]); 2] = [("dets", &[1, 2, 4]), ("labels", &[1, 2, 2])];
    let head = bound(HeadName::Detr, &[1, 3, 100, 200], &outputs);
    let boxes = [[0.5, 0.5, 0.5, 0.5], [0.25, 0.5, 0.5, 1.0]];
    let logits = [[2.0, 0.5], [-3.0, 1.0]];
    // In the first query.
    let mut no_box = boxes;
    no_box[0][2] = f32::NAN;
    let mut no_logit = logits;
    no_logit[0][1] = f32::NAN;
    for (boxes, logits) in [(no_box, logits), (boxes, no_logit)] {
        let (rejected, found) = read(
            &head,
            &[
                (&[1, 2, 4], boxes.as_flattened()),
                (&[1, 2, 2], logits.as_flattened()),
            ],
        );
        assert_eq!(rejected, 1);
        assert_candidates(&found, &[([0.0, 0.0, 100.0, 100.0], 1, sigmoid(1.0))]);
    }
}

#[test]
fn detr_reads_probabilities_as_such_beside_a_query_that_is_no_number_or_a_score_rounded_above_1() {
    let outputs: [(&str, &[i64]); 2] = [("dets", &[1, 2, 4]), ("labels", &[1, 2, 2])];
    let head = bound(HeadName::Detr, &[1, 3, 100, 200], &outputs);
    let boxes = [[0.5, 0.5, 0.5, 0.5], [0.25, 0.5, 0.5, 1.0]];
    for (probabilities, faults, score) in [
        ([[0.9, 0.01], [f32::NAN, 0.02]], 1, 0.9),
        ([[1.0005, 0.01], [0.03, 0.02]], 0, 1.0),
    ] {
        let (rejected, found) = read(
            &head,
            &[
                (&[1, 2, 4], boxes.as_flattened()),
                (&[1, 2, 2], probabilities.as_flattened()),
            ],
        );
        assert_eq!(rejected, faults);
        assert_candidates(&found, &[([50.0, 25.0, 150.0, 75.0], 0, score)]);
    }
}

#[test]
fn one_odd_number_among_the_probabilities_of_detr_does_not_turn_the_others_into_logits() {
    let outputs: [(&str, &[i64]); 2] = [("dets", &[1, 10, 4]), ("labels", &[1, 10, 2])];
    let head = bound(HeadName::Detr, &[1, 3, 100, 200], &outputs);
    let boxes = [[0.5, 0.5, 0.5, 0.5]; 10];
    let mut probabilities = [[0.01, 0.02]; 10];
    probabilities[2][1] = 0.9;
    probabilities[5][0] = 1.5;
    let (rejected, found) = read(
        &head,
        &[
            (&[1, 10, 4], boxes.as_flattened()),
            (&[1, 10, 2], probabilities.as_flattened()),
        ],
    );
    assert_eq!(rejected, 1);
    assert_candidates(&found, &[([50.0, 25.0, 150.0, 75.0], 1, 0.9)]);
}

#[test]
fn boxes_of_yolo_nas_that_are_not_written_as_corners_tell_against_it() {
    let shapes: [&[i64]; 2] = [&[1, 42, 4], &[1, 42, 2]];
    let outputs = [("boxes", shapes[0]), ("scores", shapes[1])];
    let head = bound(HeadName::YoloNas, &[1, 3, 32, 64], &outputs);
    for (sides, is_against) in [
        ([10.0, 8.0, 40.0, 20.0], false),
        ([40.0, 20.0, 10.0, 8.0], true),
    ] {
        let boxes = [sides; 42];
        let outputs = [
            TensorView {
                shape: shapes[0],
                values: boxes.as_flattened(),
            },
            TensorView {
                shape: shapes[1],
                values: &[0.0; 84],
            },
        ];
        let evidence = head.evidence(&outputs, 0.5);
        assert_eq!(matches!(evidence, Evidence::Against(_)), is_against);
    }
}

#[test]
fn yolo_nas_with_four_classes_is_read_in_any_order_beside_an_odd_score() {
    let shape: &[i64] = &[1, 42, 4];
    let outputs = [("904", shape), ("913", shape)];
    let head = bound(HeadName::YoloNas, &[1, 3, 32, 64], &outputs);
    let boxes = [[10.0_f32, 8.0, 40.0, 20.0]; 42];
    let boxes = boxes.as_flattened();
    for (odd, expected) in [(0.1, 0), (700.0, 1)] {
        let mut scores = [[0.1_f32; 4]; 42];
        scores[7][2] = 0.9;
        scores[3][1] = odd;
        let scores = scores.as_flattened();
        for [first, second] in [[boxes, scores], [scores, boxes]] {
            let (rejected, found) = read(&head, &[(shape, first), (shape, second)]);
            assert_eq!(rejected, expected);
            assert_candidates(&found, &[([10.0, 8.0, 40.0, 20.0], 2, 0.9)]);
        }
    }
}

#[test]
fn scores_that_sum_to_1_tell_against_yolo_nas_and_rows_that_are_no_cells_do_not() {
    let outputs: [(&str, &[i64]); 2] = [("scores", &[1, -1, 3]), ("boxes", &[1, -1, 4])];
    let head = bound(HeadName::YoloNas, &[1, 3, 32, 64], &outputs);
    for (rows, scores, is_against) in [
        (42, [0.1_f32, 0.2, 0.1], false),
        (42, [0.9, 0.06, 0.04], true),
        // Whoever names the head may know better.
        (50, [0.1, 0.2, 0.1], false),
    ] {
        let of_scores = [1, rows as i64, 3];
        let of_boxes = [1, rows as i64, 4];
        let outputs = [
            TensorView {
                shape: &of_scores,
                values: &scores.repeat(rows),
            },
            TensorView {
                shape: &of_boxes,
                values: &[10.0_f32, 8.0, 40.0, 20.0].repeat(rows),
            },
        ];
        let evidence = head.evidence(&outputs, 0.5);
        let found = matches!(evidence, Evidence::Against(_));
        assert_eq!(found, is_against, "{rows} rows of {scores:?}");
    }
}

#[test]
fn a_class_for_no_object_by_softmax_tells_against_detr() {
    let outputs: [(&str, &[i64]); 2] = [("dets", &[1, 4, 4]), ("labels", &[1, 4, 3])];
    let head = bound(HeadName::Detr, &[1, 3, 100, 200], &outputs);
    for (scores, is_against) in [
        // Logits: the last class may be the best of a model with sigmoids, too.
        ([-5.0_f32, -6.0, -4.0], false),
        ([-5.0, -6.0, 4.0], true),
        // Probabilities.
        ([0.01, 0.02, 0.1], false),
        ([0.01, 0.02, 0.97], true),
    ] {
        let outputs = [
            TensorView {
                shape: &[1, 4, 4],
                values: &[0.5; 16],
            },
            TensorView {
                shape: &[1, 4, 3],
                values: &scores.repeat(4),
            },
        ];
        let evidence = head.evidence(&outputs, 0.5);
        let found = matches!(evidence, Evidence::Against(_));
        assert_eq!(found, is_against, "{scores:?}");
    }
}

#[test]
fn rows_of_rt_detr_that_end_with_a_class_are_not_read_as_two_scores() {
    let shape: &[i64] = &[1, 5, 6];
    let head = bound(HeadName::RtDetr, &[1, 3, 32, 64], &[("output0", shape)]);
    let evidence = |second_score: f32| {
        let values = [0.5, 0.5, 0.2, 0.1, 0.9, second_score].repeat(5);
        let output = TensorView {
            shape,
            values: &values,
        };
        head.evidence(&[output], 0.5)
    };
    assert_eq!(evidence(0.2), Evidence::None);
    let Evidence::Against(objection) = evidence(1.0) else {
        panic!("a class is read as a score");
    };
    let words = objection.to_string();
    assert!(words.contains("cx cy w h score class"), "{words}");
}

#[test]
fn yolov5_is_read_from_its_decoded_output_beside_its_feature_maps() {
    let map: &[i64] = &[1, 3, 2, 4, 7];
    let decoded: &[i64] = &[1, 126, 7];
    let outputs = [("map", map), ("output", decoded)];
    let head = bound(HeadName::Yolov5, &[1, 3, 32, 64], &outputs);
    let mut values = vec![0.0; 126 * 7];
    values[3 * 7..4 * 7].copy_from_slice(&[32.0, 16.0, 20.0, 10.0, 0.9, 0.1, 0.8]);
    let (rejected, found) = read(&head, &[(map, &[9.0; 168]), (decoded, &values)]);
    assert_eq!(rejected, 0);
    assert_candidates(&found, &[([22.0, 11.0, 42.0, 21.0], 1, 0.72)]);
}

#[test]
fn fastestdet_decodes_its_cells_by_channel() {
    // The sigmoid of -ln 3 is a quarter, that of 0 a half.
    let quarter = -(3.0_f32.ln());
    let boxes: [(usize, &[f32]); 3] = [
        // Column 2, row 1: the centre in the cell's corner; a quarter of the picture wide and half of it high.
        (6, &[0.9, 0.0, 0.0, quarter, 0.0, 0.2, 0.8]),
        (1, &[0.2, 0.0, 0.0, 0.0, 0.0, 0.9, 0.1]),
        (2, &[0.9, 0.0, 0.0, 0.0, 0.0, 0.05, 0.1]),
    ];
    let (rejected, found) = read_boxes(HeadName::FastestDet, &boxes);
    assert_eq!(rejected, 0);
    let score = 0.9_f32.powf(0.6) * 0.8_f32.powf(0.4);
    assert_candidates(&found, &[([24.0, 8.0, 40.0, 24.0], 1, score)]);
}

#[test]
fn yolox_decodes_the_cells_of_all_three_strides() {
    let half = 0.5_f32;
    let boxes: [(usize, &[f32]); 5] = [
        // Stride 8, 8 columns: cell 11 is column 3, row 1.
        (11, &[half, 0.25, 2.0_f32.ln(), 0.0, 0.9, 0.1, 0.8]),
        // Stride 16, 4 columns: cell 32 + 6 is column 2, row 1.
        (38, &[0.0, 0.0, 0.0, 0.0, 1.0, 0.7, 0.2]),
        // Stride 32, 2 columns: cell 40 + 1 is column 1, row 0.
        (41, &[half, half, 0.0, half.ln(), 0.75, 1.0, 0.0]),
        // Objectness times score is too low; then objectness alone is.
        (0, &[0.0, 0.0, 0.0, 0.0, 0.6, 0.6, 0.0]),
        (1, &[0.0, 0.0, 0.0, 0.0, 0.49, 1.0, 0.0]),
    ];
    let (rejected, found) = read_boxes(HeadName::Yolox, &boxes);
    assert_eq!(rejected, 0);
    assert_candidates(
        &found,
        &[
            ([20.0, 6.0, 36.0, 14.0], 1, 0.72),
            ([24.0, 8.0, 40.0, 24.0], 0, 0.7),
            ([32.0, 8.0, 64.0, 24.0], 0, 0.75),
        ],
    );
}

#[test]
fn a_box_with_an_impossible_number_is_rejected_and_counted() {
    use HeadName::{EndToEnd, FastestDet, Yolo, Yolox};
    const INFINITY: f32 = f32::INFINITY;
    let yolo = [10.0, 20.0, 4.0, 8.0, 0.5, 0.1];
    let end_to_end = [1.0, 2.0, 30.0, 20.0, 0.5, 79.0];
    let cell = [0.9, 0.0, 0.0, 0.0, 0.0, 0.9, 0.1];
    let yolox = [0.0, 0.0, 0.0, 0.0, 0.9, 0.9, 0.0];
    // Numbers other than NaN that spoil a good box in these places.
    let of_yolo = [(2, -4.0), (2, INFINITY), (4, 3.0)];
    let of_end_to_end = [(0, 31.0), (5, -1.0), (5, 0.5), (5, 1e9)];
    let of_yolox = [(1, INFINITY), (2, 1e4), (3, -INFINITY), (4, 7.0), (6, -0.5)];
    // A good box, and what spoils it.
    for (name, good, others) in [
        (Yolo, &yolo[..], &of_yolo[..]),
        (EndToEnd, &end_to_end, &of_end_to_end),
        (FastestDet, &cell, &[]),
        (Yolox, &yolox, &of_yolox),
    ] {
        let (rejected, found) = read_boxes(name, &[(0, good)]);
        assert_eq!(rejected, 0, "{name:?}");
        assert_eq!(found.len(), 1, "{name:?}");
        let not_numbers = (0..good.len()).map(|place| (place, f32::NAN));
        for (place, number) in not_numbers.chain(others.iter().copied()) {
            let mut row = good.to_vec();
            row[place] = number;
            let (rejected, found) = read_boxes(name, &[(0, &row)]);
            assert_eq!(rejected, 1, "{name:?}: {number} in place {place}");
            assert!(found.is_empty(), "{name:?}: {number} in place {place}");
        }
    }
}

#[test]
fn an_output_of_another_shape_than_announced_is_an_error_for_every_head() {
    // Enough for two pictures of the largest, 42 rows of seven numbers.
    let numbers = [0.0; 2 * 42 * 7];
    for (head, shapes) in heads() {
        let attempt = |views: &[TensorView<'_>]| head.read(views, 0.5, &mut Vec::new());
        assert!(attempt(&views(&shapes, &numbers)).is_ok(), "{head:?}");
        assert!(attempt(&[]).is_err(), "{head:?}");
        for place in 0..shapes[0].len() {
            let longer = shapes[0][place] + 1;
            for side in [longer, -1, i64::MAX] {
                let mut other = shapes.clone();
                other[0][place] = side;
                // Its elements are still those of the announced shape.
                let mut contradictory = views(&shapes, &numbers);
                contradictory[0].shape = &other[0];
                assert!(attempt(&contradictory).is_err(), "{head:?}: {side}");
            }
            let mut other = shapes.clone();
            other[0][place] = longer;
            let error = attempt(&views(&other, &numbers)).unwrap_err();
            assert!(error.contains("instead of ["), "{head:?}: {error}");
        }
    }
}

/// Outputs of these shapes, each filled from the start of `numbers`.
fn views<'a>(shapes: &'a [Vec<i64>], numbers: &'a [f32]) -> Vec<TensorView<'a>> {
    let view = |shape: &'a Vec<i64>| TensorView {
        shape,
        values: &numbers[..shape.iter().product::<i64>() as usize],
    };
    shapes.iter().map(view).collect()
}

proptest! {
    #[test]
    fn any_output_gives_valid_candidates_and_no_panic(
        numbers in prop::collection::vec(
            prop_oneof![6 => 0.0_f32..1.0, 2 => -10.0_f32..70.0, 1 => any::<f32>(), 1 => Just(f32::NAN)],
            42 * 7,
        ),
        confidence in 0.0_f64..=1.0,
    ) {
        for (head, shapes) in heads() {
            let mut candidates = Vec::new();
            let views = views(&shapes, &numbers);
            let rejected = head.read(&views, confidence, &mut candidates).unwrap();
            // Four queries with two classes; of the others none has more than 42 rows.
            let rows = if head.name == HeadName::Detr { 4 * 2 } else { 42 };
            prop_assert!(rejected as usize + candidates.len() <= rows);
            for Candidate { corners, confidence: score, class } in candidates {
                let Corners { x1, y1, x2, y2 } = corners;
                prop_assert!(x1 < x2 && y1 < y2);
                prop_assert!([x1, y1, x2, y2].iter().all(|side| side.is_finite()));
                prop_assert!((0.0..=1.0).contains(&score));
                prop_assert!(f64::from(score) >= confidence - 1e-6, "{score} {confidence}");
                let known = head.classes.is_none_or(|classes| usize::from(class.0) < classes);
                prop_assert!(known);
            }
        }
    }
}
