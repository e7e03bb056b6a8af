//! The heads on tensors made by hand.

use super::*;
use crate::detector::TensorSpec;
use crate::geometry::PictureSize;

fn spec(name: &str, shape: &[i64]) -> TensorSpec {
    TensorSpec {
        name: name.to_owned(),
        is_float32: true,
        element_type: "float32".to_owned(),
        shape: shape.to_vec(),
    }
}

fn signature(input: &[i64], output: &[i64]) -> Signature {
    Signature {
        inputs: vec![spec("images", input)],
        outputs: vec![spec("output", output)],
    }
}

/// A YOLOX head for 64x32 and 2 classes: 32 + 8 + 2 cells of 7 numbers.
fn yolox() -> Head {
    Head::bind(HeadName::Yolox, &signature(&[1, 3, 32, 64], &[1, 42, 7]), 2).unwrap()
}

fn demonstration() -> Head {
    Head::bind(
        HeadName::Demonstration,
        &signature(&[1, 3, 192, 320], &[1, 3, 11]),
        7,
    )
    .unwrap()
}

fn read(head: &Head, shape: &[i64], values: &[f32]) -> (u64, Vec<Candidate>) {
    let mut candidates = Vec::new();
    let rejected = head
        .read(&[TensorView { shape, values }], 0.5, &mut candidates)
        .unwrap();
    (rejected, candidates)
}

/// A YOLOX output that is empty but for these rows.
fn yolox_output(rows: &[(usize, [f32; 7])]) -> Vec<f32> {
    let mut values = vec![0.0; 42 * 7];
    for (cell, row) in rows {
        values[cell * 7..][..7].copy_from_slice(row);
    }
    values
}

#[test]
fn yolox_decodes_the_cells_of_all_three_strides() {
    let half = 0.5_f32;
    let output = yolox_output(&[
        // Stride 8, 8 columns: cell 11 is column 3, row 1.
        (11, [half, 0.25, 2.0_f32.ln(), 0.0, 0.9, 0.1, 0.8]),
        // Stride 16, 4 columns: cell 32 + 6 is column 2, row 1.
        (38, [0.0, 0.0, 0.0, 0.0, 1.0, 0.7, 0.2]),
        // Stride 32, 2 columns: cell 40 + 1 is column 1, row 0.
        (41, [half, half, 0.0, half.ln(), 0.75, 1.0, 0.0]),
    ]);
    let (rejected, candidates) = read(&yolox(), &[1, 42, 7], &output);
    assert_eq!(rejected, 0);
    let expected = [
        ([20.0, 6.0, 36.0, 14.0], 1, 0.72),
        ([24.0, 8.0, 40.0, 24.0], 0, 0.7),
        ([32.0, 8.0, 64.0, 24.0], 0, 0.75),
    ];
    assert_eq!(candidates.len(), expected.len());
    for (found, (corners, class, confidence)) in candidates.iter().zip(expected) {
        let Corners { x1, y1, x2, y2 } = found.corners;
        for (found, expected) in [x1, y1, x2, y2].into_iter().zip(corners) {
            assert!(
                (found - expected).abs() < 1e-5,
                "{found} instead of {expected}"
            );
        }
        assert_eq!(found.class, ClassId(class));
        assert!((found.confidence - confidence).abs() < 1e-6);
    }
}

#[test]
fn yolox_multiplies_objectness_and_class_score() {
    let output = yolox_output(&[
        (0, [0.0, 0.0, 0.0, 0.0, 0.6, 0.6, 0.0]),
        (1, [0.0, 0.0, 0.0, 0.0, 0.49, 1.0, 0.0]),
    ]);
    assert_eq!(read(&yolox(), &[1, 42, 7], &output), (0, vec![]));
}

#[test]
fn yolox_rejects_and_counts_what_is_not_a_number_or_not_possible() {
    let good = [0.0, 0.0, 0.0, 0.0, 0.9, 0.9, 0.0];
    let with = |index: usize, value: f32| {
        let mut row = good;
        row[index] = value;
        row
    };
    let output = yolox_output(&[
        (0, with(0, f32::NAN)),
        (1, with(1, f32::INFINITY)),
        (2, with(2, 1e4)),
        (3, with(3, f32::NEG_INFINITY)),
        (4, with(4, f32::NAN)),
        (5, with(4, 7.0)),
        (6, with(5, f32::NAN)),
        (7, with(6, -0.5)),
        (8, good),
    ]);
    let (rejected, candidates) = read(&yolox(), &[1, 42, 7], &output);
    assert_eq!(rejected, 8);
    assert_eq!(candidates.len(), 1);
}

#[test]
fn the_demonstration_head_reads_corners_and_the_best_class() {
    let mut output = vec![0.0; 33];
    output[..11].copy_from_slice(&[10.0, 20.0, 110.0, 80.0, 0.1, 0.0, 0.8, 0.3, 0.0, 0.0, 0.0]);
    output[11..22].copy_from_slice(&[0.0, 0.0, 5.0, 5.0, 0.49, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    output[22..].copy_from_slice(&[9.0, 9.0, 8.0, 20.0, 0.9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let (rejected, candidates) = read(&demonstration(), &[1, 3, 11], &output);
    // The last is inside out.
    assert_eq!(rejected, 1);
    let expected = Candidate {
        corners: Corners {
            x1: 10.0,
            y1: 20.0,
            x2: 110.0,
            y2: 80.0,
        },
        class: ClassId(2),
        confidence: 0.8,
    };
    assert_eq!(candidates, [expected]);
}

#[test]
fn the_demonstration_head_rejects_and_counts_what_is_not_a_number() {
    let (rejected, candidates) = read(&demonstration(), &[1, 3, 11], &[f32::NAN; 33]);
    assert_eq!((rejected, candidates.len()), (3, 0));
}

#[test]
fn an_output_of_another_shape_than_announced_is_an_error() {
    let mut candidates = Vec::new();
    let values = vec![0.0; 43 * 7];
    for (shape, length) in [
        (&[1, 43, 7][..], 43 * 7),
        (&[42, 7], 42 * 7),
        (&[1, 42, 7], 41 * 7),
    ] {
        let view = TensorView {
            shape,
            values: &values[..length],
        };
        let error = yolox().read(&[view], 0.5, &mut candidates).unwrap_err();
        assert!(error.contains("[1, 42, 7]"), "{error}");
    }
    assert!(yolox().read(&[], 0.5, &mut candidates).is_err());
    assert!(candidates.is_empty());
}

#[test]
fn the_input_size_is_the_models() {
    assert_eq!(yolox().input_format().size, PictureSize::new(64, 32));
    assert_eq!(
        demonstration().input_format().size,
        PictureSize::new(320, 192)
    );
}

#[test]
fn a_model_that_does_not_fit_is_refused_with_the_first_difference() {
    use HeadName::{Demonstration, Yolox};
    let input = [1, 3, 416, 416];
    for (name, signature, classes, reason) in [
        (Yolox, signature(&input, &[1, 3549, 84]), 80, "79 classes"),
        (
            Yolox,
            signature(&input, &[1, 84, 8400]),
            80,
            "another shape",
        ),
        (
            Yolox,
            signature(&[1, 3, 400, 416], &[1, 1, 85]),
            80,
            "multiple of 32",
        ),
        (
            Yolox,
            signature(&[1, 3, -1, -1], &[1, 3549, 85]),
            80,
            "open",
        ),
        (
            Yolox,
            signature(&[1, 416, 416, 3], &[1, 3549, 85]),
            80,
            "NHWC",
        ),
        (
            Yolox,
            signature(&[1, 416], &[1, 3549, 85]),
            80,
            "[1, 3, rows, columns]",
        ),
        (
            Yolox,
            signature(&[1, 3, 9000, 9000], &[1, 3549, 85]),
            80,
            "8192",
        ),
        (
            Demonstration,
            signature(&input, &[1, 1000, 12]),
            7,
            "8 classes",
        ),
        (
            Demonstration,
            signature(&input, &[1, 2]),
            7,
            "another shape",
        ),
        (
            Demonstration,
            signature(&input, &[1, 0, 11]),
            7,
            "another shape",
        ),
        (
            Demonstration,
            signature(&input, &[1, -1, 11]),
            7,
            "another shape",
        ),
    ] {
        let misfit = Head::bind(name, &signature, classes).unwrap_err();
        assert!(misfit.reason.contains(reason), "{misfit:?}");
        assert!(misfit.expected.contains("float32"), "{misfit:?}");
    }
}

#[test]
fn more_than_one_output_or_another_element_type_is_refused() {
    let mut two = signature(&[1, 3, 64, 64], &[1, 5, 11]);
    two.outputs.push(spec("more", &[1]));
    let reason = Head::bind(HeadName::Demonstration, &two, 7)
        .unwrap_err()
        .reason;
    assert!(reason.contains("2 outputs"), "{reason}");
    let mut half = signature(&[1, 3, 64, 64], &[1, 5, 11]);
    half.inputs[0].is_float32 = false;
    half.inputs[0].element_type = "float16".to_owned();
    let reason = Head::bind(HeadName::Demonstration, &half, 7)
        .unwrap_err()
        .reason;
    assert!(reason.contains("float16"), "{reason}");
}

#[test]
fn a_signature_reads_like_a_sentence() {
    let text = signature(&[1, 3, 416, -1], &[1, 3549, 85]).to_string();
    assert_eq!(
        text,
        "input `images` float32 [1, 3, 416, ?] and output `output` float32 [1, 3549, 85]"
    );
}
