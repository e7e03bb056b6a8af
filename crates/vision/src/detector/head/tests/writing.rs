//! How the numbers of a run are written, by those of most of its boxes.

use super::*;

const INPUT: [i64; 4] = [1, 3, 32, 64];

/// What a run in which the only output has these numbers says against a head.
fn against(head: &Head, shape: &[i64], values: &[f32]) -> Option<Objection> {
    let output = TensorView { shape, values };
    match head.evidence(&[output], 1e-4) {
        Evidence::Against(objection) => Some(objection),
        Evidence::For | Evidence::None => None,
    }
}

/// The centres of the 42 cells of the input.
fn cell_centres() -> Vec<[f32; 2]> {
    let mut centres = Vec::new();
    for stride in [8_u8, 16, 32] {
        for line in 0..32 / stride {
            for column in 0..64 / stride {
                centres
                    .push([column, line].map(|place| (f32::from(place) + 0.5) * f32::from(stride)));
            }
        }
    }
    centres
}

#[test]
fn one_box_wider_than_two_inputs_does_not_turn_parts_of_its_sides_into_pixels() {
    let sure: &[f32] = &[0.5, 0.5, 0.25, 0.5, 0.9, 0.1];
    let unsure: &[f32] = &[0.25, 0.25, 0.1, 0.1, 0.1, 0.1];
    let odd: &[f32] = &[0.5, 0.5, 2.5, 0.5, 0.1, 0.1];
    let (rejected, found) = read_boxes(HeadName::Yolo, &[(0, sure), (1, unsure), (2, odd)]);
    assert_eq!(rejected, 0);
    assert_candidates(&found, &[([24.0, 8.0, 40.0, 24.0], 0, 0.9)]);

    let shape = [1, 42, 6];
    let head = bound(HeadName::Yolo, &INPUT, &[("output", &shape)]);
    let mut values = [sure, unsure, odd].concat();
    values.resize(42 * 6, 0.0);
    let (rejected, found) = read(&head, &[(&shape, &values)]);
    assert_eq!(rejected, 0);
    assert_candidates(&found, &[([24.0, 8.0, 40.0, 24.0], 0, 0.9)]);

    let first: &[f32] = &[0.375, 0.25, 0.625, 0.75, 0.9, 1.0];
    let second: &[f32] = &[0.0, 0.0, 0.5, 1.0, 0.8, 0.0];
    let odd: &[f32] = &[0.0, 0.25, 2.5, 0.5, 0.7, 0.0];
    let (rejected, found) = read_boxes(HeadName::EndToEnd, &[(0, first), (1, second), (2, odd)]);
    assert_eq!(rejected, 0);
    assert_candidates(
        &found,
        &[
            ([24.0, 8.0, 40.0, 24.0], 1, 0.9),
            ([0.0, 0.0, 32.0, 32.0], 0, 0.8),
            ([0.0, 8.0, 160.0, 16.0], 0, 0.7),
        ],
    );
}

#[test]
fn decoded_boxes_of_yolox_in_parts_of_the_inputs_sides_are_not_read_as_logarithms() {
    let in_sides = |[x, y]: [f32; 2]| [x / 64.0, y / 32.0, 0.25, 0.25, 0.0, 0.8, 0.2];
    let mut rows: Vec<_> = cell_centres().into_iter().map(in_sides).collect();
    // Stride 8, 8 columns: cell 11 is column 3, row 1.
    rows[11][4] = 1.0;
    // One that is odd and unsure.
    rows[0][2] = 9.0;
    let boxes: Vec<(usize, &[f32])> =
        rows.iter().enumerate().map(|(number, row)| (number, &row[..])).collect();
    let (rejected, found) = read_boxes(HeadName::Yolox, &boxes);
    assert_eq!(rejected, 0);
    assert_candidates(&found, &[([20.0, 8.0, 36.0, 16.0], 0, 0.8)]);
}

#[test]
fn offsets_and_logarithms_of_yolox_at_small_inputs_are_not_taken_for_parts_of_its_sides() {
    let shape = [1, 42, 7];
    // Of wide boxes, whose logarithms are positive. Nearly all centres would be near their cells, as the input has so few.
    let mut values = [0.5, 0.4, 0.3, 0.2, 0.1, 0.1, 0.1].repeat(42);
    // Stride 8, 8 columns: cell 11 is column 3, row 1.
    values[11 * 7..][..7].copy_from_slice(&[0.5, 0.25, 2.0_f32.ln(), 0.0, 0.9, 0.1, 0.8]);
    let head = bound(HeadName::Yolox, &INPUT, &[("output", &shape)]);
    let (rejected, found) = read(&head, &[(&shape, &values)]);
    assert_eq!(rejected, 0);
    assert_candidates(&found, &[([20.0, 6.0, 36.0, 14.0], 1, 0.72)]);
}

#[test]
fn the_first_run_with_boxes_says_for_all_whether_yolox_is_decoded() {
    let shape = [1, 42, 7];
    let head = bound(HeadName::Yolox, &INPUT, &[("output", &shape)]);
    let sure = |sides: [f32; 4]| {
        let mut values = vec![0.0; 42 * 7];
        values[..7].copy_from_slice(&[sides[0], sides[1], sides[2], sides[3], 1.0, 1.0, 0.0]);
        read(&head, &[(&shape, &values)]).1
    };
    // Nothing at all decides nothing.
    read(&head, &[(&shape, &[0.0; 42 * 7])]);
    let decoded = sure([32.0, 16.0, 20.0, 10.0]);
    assert_candidates(&decoded, &[([22.0, 11.0, 42.0, 21.0], 0, 1.0)]);
    // Smaller than e^8 cells.
    let small = sure([5.0, 5.0, 4.0, 4.0]);
    assert_candidates(&small, &[([3.0, 3.0, 7.0, 7.0], 0, 1.0)]);
}

/// How a box around the centre of its cell is written.
type Write = fn([f32; 2]) -> [f32; 4];

fn corners([x, y]: [f32; 2]) -> [f32; 4] {
    [x - 4.0, y - 4.0, x + 4.0, y + 4.0]
}

/// [`corners`] as parts of the input's sides.
fn parts(centre: [f32; 2]) -> [f32; 4] {
    let [x1, y1, x2, y2] = corners(centre);
    [x1 / 64.0, y1 / 32.0, x2 / 64.0, y2 / 32.0]
}

#[test]
fn corners_in_place_of_centre_and_sides_tell_against_yolo_and_wide_boxes_do_not() {
    let cases: [(Write, bool); 6] = [
        (corners, true),
        (parts, true),
        (|[x, y]| [x, y, 8.0, 8.0], false),
        // Three quarters of the input.
        (|[x, y]| [x, y, 48.0, 24.0], false),
        // As of a model that is not trained.
        (|[x, y]| [x, y, 200.0, 200.0], false),
        (|_| [24.0, 12.0, 32.0, 16.0], false),
    ];
    let by_row = bound(HeadName::Yolo, &INPUT, &[("output", &[1, 42, 6])]);
    let by_column = bound(HeadName::Yolo, &INPUT, &[("output", &[1, 6, 42])]);
    for (number, (write, is_against)) in cases.into_iter().enumerate() {
        let mut of_rows = vec![0.0; 42 * 6];
        let mut of_columns = vec![0.0; 42 * 6];
        for (anchor, centre) in cell_centres().into_iter().enumerate() {
            for (place, side) in write(centre).into_iter().enumerate() {
                of_rows[anchor * 6 + place] = side;
                of_columns[place * 42 + anchor] = side;
            }
        }
        for reason in [
            against(&by_row, &[1, 42, 6], &of_rows),
            against(&by_column, &[1, 6, 42], &of_columns),
        ] {
            assert_eq!(reason.is_some(), is_against, "case {number}: {reason:?}");
        }
    }
}

#[test]
fn rows_of_final_boxes_tell_against_rt_detr_and_queries_do_not() {
    let shape = [1, 20, 7];
    let head = bound(HeadName::RtDetr, &INPUT, &[("output", &shape)]);
    let query = [0.5, 0.4, 0.2, 0.1, 0.01, 0.02, 0.03];
    for (row, is_against) in [
        (query, false),
        // Sides that are 0 or 1 everywhere, on black.
        ([0.5, 0.4, 1.0, 0.1, 0.01, 0.02, 0.03], false),
        ([0.5, 0.4, 0.0, 0.0, 0.01, 0.02, 0.03], false),
        // Nothing, as of a model that writes zeros below a threshold.
        ([0.0; 7], false),
        // Unused.
        ([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], true),
        // The number of the picture, the class, the score and two corners.
        ([0.0, 1.0, 0.9, 0.42, 0.45, 0.58, 0.55], true),
        // In pixels.
        ([20.5, 10.5, 40.5, 20.5, 0.9, 0.0, 0.0], true),
    ] {
        let reason = against(&head, &shape, &row.repeat(20));
        assert_eq!(reason.is_some(), is_against, "{row:?}: {reason:?}");
    }
}

#[test]
fn boxes_of_rt_detr_in_pixels_are_impossible() {
    let shape = [1, 2, 7];
    let head = bound(HeadName::RtDetr, &INPUT, &[("output", &shape)]);
    let sure = [32.0, 16.0, 20.0, 10.0, 0.9, 0.1, 0.1];
    let (rejected, found) = read(&head, &[(&shape, &sure.repeat(2))]);
    assert_eq!(rejected, 2);
    assert!(found.is_empty(), "{found:?}");
}

#[test]
fn a_score_and_a_class_in_each_others_place_are_counted_and_tell_against_the_columns() {
    let boxes = bound(HeadName::EndToEnd, &INPUT, &[("output", &[1, 4, 6])]);
    let flat = bound(HeadName::Yolov5, &INPUT, &[("output", &[-1, 7])]);
    // The last two are unused.
    let class_before_score = [
        [1.0, 2.0, 30.0, 20.0, 0.0, 0.9],
        [1.0, 2.0, 30.0, 20.0, 0.0, 0.003],
        [0.0; 6],
        [-1.0; 6],
    ];
    let score_before_class = [
        [0.0, 1.0, 2.0, 30.0, 20.0, 0.9, 0.0],
        [0.0, 1.0, 2.0, 30.0, 20.0, 0.6, 0.0],
        [0.0; 7],
        [-1.0; 7],
    ];
    for (head, shape, values) in [
        (&boxes, &[1, 4, 6][..], class_before_score.as_flattened()),
        (&flat, &[4, 7], score_before_class.as_flattened()),
    ] {
        let (rejected, found) = read(head, &[(shape, values)]);
        assert_eq!(rejected, 2, "{head:?}");
        assert!(found.is_empty(), "{head:?}");
        let words = against(head, shape, values).unwrap().to_string();
        assert!(words.contains("exchanged"), "{words}");
        // Not the order that has just been refuted.
        assert!(!words.contains("score class"), "{words}");
    }
}
