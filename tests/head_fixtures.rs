//! Heads and preprocessing against results of the vendors' own code, written by `make parity`.

use super::support::project;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::detector::HeadName;
use albireo_vision::detector::head::{self, HeadOverrides, Suppression, keep_best, suppress};
use albireo_vision::onnx::{ElementType, Metadata, Signature, TensorSpec, TensorView};
use albireo_vision::picture::{
    ColorOrder, Fit, InputElement, InputFormat, Letterbox, Picture, PixelLayout, TensorLayout,
    ValueRange,
};
use flate2::read::GzDecoder;
use rstest::rstest;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fs::File;

#[derive(Deserialize)]
struct Tensor {
    shape: Vec<i64>,
    values: Vec<f32>,
}

/// Outputs of a head and the vendor's boxes: rows of x1, y1, x2, y2, score, class in input pixels.
#[derive(Deserialize)]
struct HeadFixture {
    columns: i64,
    rows: i64,
    #[serde(default)]
    names: Vec<String>,
    outputs: Vec<Tensor>,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    confidence: f64,
    overlap: f64,
    per_class: bool,
    most: usize,
    boxes: Tensor,
}

/// A picture (rows, columns, colours) and the vendor's input for it.
#[derive(Deserialize)]
struct InputFixture {
    picture: Tensor,
    input: Tensor,
}

fn fixture<T: DeserializeOwned>(name: &str) -> T {
    let path = project(&format!("tests/fixtures/parity/{name}.json.gz"));
    let file = File::open(path).expect("the fixture is there");
    serde_json::from_reader(GzDecoder::new(file)).expect("the fixture can be read")
}

fn spec(name: &str, shape: &[i64]) -> TensorSpec {
    TensorSpec {
        name: name.to_owned(),
        element: ElementType::Float32,
        shape: shape.to_vec(),
    }
}

/// How the vendors fit a picture into the input, and its range.
const YOLO_INPUT: (Fit, ValueRange) = (Fit::Centre, ValueRange::ToOne);
const DETR_INPUT: (Fit, ValueRange) = (Fit::Stretch, ValueRange::ImageNet);

#[rstest]
#[case::yolo_and_suppression_with_ultralytics("head_yolo", HeadName::Yolo, YOLO_INPUT, 100)]
#[case::end_to_end_with_ultralytics("head_end_to_end", HeadName::EndToEnd, YOLO_INPUT, 20)]
#[case::detr_with_rf_detr("head_detr", HeadName::Detr, DETR_INPUT, 20)]
fn the_boxes_agree_with_the_vendors_code(
    #[case] name: &str,
    #[case] expected_head: HeadName,
    #[case] expected_input: (Fit, ValueRange),
    #[case] least_boxes: usize,
) {
    let fixture: HeadFixture = fixture(name);
    let output_name = |place: usize| fixture.names.get(place).map_or("output0", String::as_str);
    let signature = Signature {
        inputs: vec![spec("images", &[1, 3, fixture.rows, fixture.columns])],
        outputs: fixture
            .outputs
            .iter()
            .enumerate()
            .map(|(place, output)| spec(output_name(place), &output.shape))
            .collect(),
        metadata: Metadata::default(),
    };
    let input = signature.picture_input(None).expect("a picture input");
    let views: Vec<_> = fixture
        .outputs
        .iter()
        .map(|output| TensorView {
            shape: &output.shape,
            values: &output.values,
        })
        .collect();
    let fitting = head::recognise(&signature, input, None).expect("recognised");
    let found = match fitting.only(&signature) {
        Some(found) => found,
        None => {
            let told = fitting.by_values(&signature, input, None, &views);
            told.expect("told by its values")
        }
    };
    assert_eq!(found.name, expected_head);
    let overrides = HeadOverrides::default();
    let head = head::bind(&found.name.into(), &signature, input, overrides).expect("it fits");
    let format = head.input_format;
    assert_eq!((format.fit, format.value_range), expected_input);
    let (width, height) = (fixture.columns as f64, fixture.rows as f64);
    let mut boxes = 0;
    for case in &fixture.cases {
        let mut candidates = Vec::new();
        let rejected = head.read(&views, case.confidence, &mut candidates).unwrap();
        assert_eq!(rejected, 0);
        if head.overlaps_in(&views) {
            let settings = Suppression {
                overlap: case.overlap,
                per_class: case.per_class,
                most: case.most,
            };
            suppress(&mut candidates, settings);
        } else {
            keep_best(&mut candidates, case.most);
        }
        assert_eq!(candidates.len(), case.boxes.values.len() / 6);
        boxes += candidates.len();
        for expected in case.boxes.values.chunks_exact(6) {
            // Boxes of equal score may be in another order.
            let same = candidates.iter().any(|candidate| {
                let Corners { x1, y1, x2, y2 } = candidate.corners;
                let sides = [(x1, width), (y1, height), (x2, width), (y2, height)];
                let are_the_same = sides.iter().zip(expected).all(|((side, most), expected)| {
                    let off = |side: f64| (side - f64::from(*expected)).abs();
                    // RF-DETR's own code clips boxes at once, ours later.
                    off(*side) < 1e-2 || off(side.clamp(0.0, *most)) < 1e-2
                });
                are_the_same
                    && f32::from(candidate.class.0) == expected[5]
                    && (candidate.confidence - expected[4]).abs() < 1e-5
            });
            assert!(same, "{expected:?} is not among {candidates:?}");
        }
    }
    assert!(boxes >= least_boxes, "only {boxes} boxes");
}

/// In levels of 0 to 255: the largest difference, and the mean. Only ours rounds to whole levels, once per direction.
#[rstest]
#[case::yolo_with_ultralytics("input_yolo", YOLO_INPUT, 2.01, 0.25)]
#[case::detr_with_rf_detr("input_detr", DETR_INPUT, 1.51, 0.5)]
fn the_input_agrees_with_the_vendors_code_up_to_rounding(
    #[case] name: &str,
    #[case] format: (Fit, ValueRange),
    #[case] most: f64,
    #[case] most_in_the_mean: f64,
) {
    let (fit, value_range) = format;
    let fixture: InputFixture = fixture(name);
    let size_of = |sides: &[i64]| PictureSize::new(sides[1] as u32, sides[0] as u32);
    let size = size_of(&fixture.picture.shape);
    let picture = Picture {
        size,
        source_size: size,
        layout: PixelLayout::Rgb8,
        pixels: fixture.picture.values.iter().map(|&v| v as u8).collect(),
    };
    let mut letterbox = Letterbox::new(InputFormat {
        size: size_of(&fixture.input.shape[1..]),
        fit,
        color_order: ColorOrder::Rgb,
        value_range,
        layout: TensorLayout::Nchw,
        element: InputElement::Float,
    });
    letterbox.fill(&picture).unwrap();
    let ours = letterbox.tensor().to_floats();
    assert_eq!(ours.len(), fixture.input.values.len());
    let plane = ours.len() / 3;
    let mut largest = 0.0_f64;
    let mut sum = 0.0;
    for (place, (ours, theirs)) in ours.iter().zip(&fixture.input.values).enumerate() {
        let level = match value_range {
            ValueRange::ImageNet => 255.0 * [0.229, 0.224, 0.225][place / plane],
            _ => 255.0,
        };
        let difference = f64::from((ours - theirs).abs()) * level;
        largest = largest.max(difference);
        sum += difference;
    }
    let mean = sum / ours.len() as f64;
    let is_close = largest < most && mean < most_in_the_mean;
    assert!(is_close, "{largest} {mean}");
}
