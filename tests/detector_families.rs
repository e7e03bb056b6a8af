//! The exports of many families, as graphs of constants: the planted boxes are found where they lie in the picture, or the
//! refusal names a setting with which they are.

use super::support::onnx::{FLOAT, INT8, INT16, INT32, INT64, Planted, UINT8, UINT16, UINT32};
use super::support::{assert_contains, shared};
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::detector::{ClassNames, DetectorConfig, DetectorNetwork};
use albireo_vision::picture::{Fit, Picture, ValueRange};
use std::path::PathBuf;

const SIZE: PictureSize = PictureSize::new(640, 360);
const INPUT: [i64; 4] = [1, 3, 640, 640];

/// A box of 100x60 around (320, 320) in the input, in a picture with grey margins above and below.
const IN_MARGINS: [f64; 4] = [270.0, 150.0, 370.0, 210.0];
/// The same in a picture in the upper left corner of the input, clipped.
const IN_CORNER: [f64; 4] = [270.0, 290.0, 370.0, 350.0];
/// The same in a picture that is stretched to the input.
const STRETCHED: [f64; 4] = [270.0, 163.125, 370.0, 196.875];

type Change = fn(&mut DetectorConfig);

fn nothing(_: &mut DetectorConfig) {}

fn coco(config: &mut DetectorConfig) {
    config.class_names = Some(ClassNames::File("coco".into()));
}

fn open(model: PathBuf, changes: &[Change]) -> Result<DetectorNetwork, String> {
    let mut config = DetectorConfig {
        model,
        report_classes: Some(Vec::new()),
        ..DetectorConfig::default()
    };
    for change in changes {
        change(&mut config);
    }
    DetectorNetwork::open(&config).map_err(|error| error.to_string())
}

/// The classes and corners that a model finds in a picture of [`SIZE`].
fn found(network: &mut DetectorNetwork) -> Vec<(String, [f64; 4])> {
    let prepared = network.preparation().prepare(&Picture::black(SIZE)).unwrap();
    let detections = network.detect(&prepared).unwrap().detections;
    let mut found = Vec::new();
    for detection in detections {
        let Corners { x1, y1, x2, y2 } = detection.bounding_box.pixel_corners(SIZE);
        let name = network.class_names()[usize::from(detection.class.0)].clone();
        found.push((name, [x1, y1, x2, y2]));
    }
    found
}

#[track_caller]
fn assert_found(network: &mut DetectorNetwork, expected: &[(&str, [f64; 4])]) {
    let found = found(network);
    let about = network.description();
    assert_eq!(found.len(), expected.len(), "{about}: {found:?}");
    for (name, corners) in expected {
        let is_there = found.iter().any(|(class, place)| {
            class == name && place.iter().zip(corners).all(|(a, b)| (a - b).abs() < 0.1)
        });
        assert!(is_there, "{about}: no {name} {corners:?} in {found:?}");
    }
}

/// Rows of these numbers at the start of an output with rows of `length`.
fn rows(length: usize, rows: &[&[f32]]) -> Vec<(usize, f32)> {
    let mut places = Vec::new();
    for (row, numbers) in rows.iter().enumerate() {
        for (column, &number) in numbers.iter().enumerate() {
            places.push((row * length + column, number));
        }
    }
    places
}

/// A model with one output.
fn one(name: &'static str, shape: &[i64], rest: f32, places: &[(usize, f32)]) -> Planted {
    Planted::default()
        .input("images", &INPUT)
        .output(name, shape, shape, rest, places)
}

const CENTRED: [f32; 4] = [320.0, 320.0, 100.0, 60.0];
const CORNERS: [f32; 4] = [270.0, 290.0, 370.0, 350.0];
/// [`CENTRED`] as parts of the input.
const PARTS: [f32; 4] = [0.5, 0.5, 0.156_25, 0.093_75];

fn row(sides: [f32; 4], rest: &[f32]) -> Vec<f32> {
    [&sides[..], rest].concat()
}

fn with_metadata(planted: Planted) -> Planted {
    let names: Vec<_> = (0..80).map(|number| format!("{number}: 'c{number}'")).collect();
    let names = format!("{{{}}}", names.join(", "));
    planted
        .entry("author", "Ultralytics")
        .entry("task", "detect")
        .entry("names", &names)
}

/// A score of .9 for class 2 of 80, after numbers that come before the classes.
fn third_class(before: &[f32], score: f32) -> Vec<f32> {
    [before, &[0.0, 0.0, score]].concat()
}

#[rstest::rstest]
#[case::yolo_with_logits(
    {
        let anchors = 8400;
        let mut planted: Vec<_> = (0..4 * anchors).map(|place| (place, 0.0)).collect();
        for (number, side) in CENTRED.into_iter().enumerate() {
            planted[number * anchors + 7].1 = side;
        }
        planted.push((6 * anchors + 7, 3.0));
        one("output0", &[1, 84, 8400], -6.0, &planted)
    },
    nothing, "car", IN_MARGINS
)]
#[case::yolo_from_0_to_1(
    one("output0", &[1, 84, 8400], 0.0, &[
        (7, PARTS[0]), (8400 + 7, PARTS[1]), (2 * 8400 + 7, PARTS[2]), (3 * 8400 + 7, PARTS[3]), (6 * 8400 + 7, 0.9),
    ]),
    nothing, "car", IN_MARGINS
)]
#[case::yolo_transposed(
    one("output0", &[1, 8400, 84], 0.0, &rows(84, &[&third_class(&CENTRED, 0.9)])), nothing, "car", IN_MARGINS
)]
#[case::yolov5(
    one("output0", &[1, 25200, 85], 0.0, &rows(85, &[&third_class(&row(CENTRED, &[0.95]), 0.95)])),
    nothing, "car", IN_MARGINS
)]
#[case::yolov7_with_its_feature_maps(
    one("output", &[1, 25200, 85], 0.0, &rows(85, &[&third_class(&row(CENTRED, &[0.95]), 0.95)]))
        .output("map", &[1, 3, 20, 20, 85], &[1, 3, 20, 20, 85], 3.0, &[]),
    nothing, "car", IN_MARGINS
)]
#[case::yolov6(
    one("outputs", &[1, 8400, 85], 0.0, &rows(85, &[&third_class(&row(CENTRED, &[1.0]), 0.9)])),
    nothing, "car", IN_MARGINS
)]
#[case::yolox_decoded(
    one("output", &[1, 8400, 85], 0.0, &rows(85, &[&third_class(&row(CENTRED, &[0.95]), 0.9)])),
    nothing, "car", IN_CORNER
)]
#[case::deepstream(
    one("output", &[1, 8400, 6], 0.0, &rows(6, &[&row(CORNERS, &[0.9, 2.0])])), coco, "car", IN_MARGINS
)]
#[case::yolov10_of_its_authors(
    with_metadata(one("output0", &[1, 300, 6], 0.0, &rows(6, &[&row(CORNERS, &[0.9, 2.0])]))),
    nothing, "c2", IN_MARGINS
)]
#[case::suppression_inside(
    with_metadata(one("output0", &[1, 300, 6], 0.0, &rows(6, &[&row(CORNERS, &[0.9, 2.0])])))
        .entry("args", "{\"batch\": 1, \"nms\": true}"),
    nothing, "c2", IN_MARGINS
)]
#[case::rt_detr_of_ultralytics(
    with_metadata(one("output0", &[1, 300, 84], 0.0, &rows(84, &[&third_class(&PARTS, 0.9)]))),
    nothing, "c2", STRETCHED
)]
#[case::rt_detr_of_ultralytics_8_4(
    with_metadata(one("output0", &[1, 300, 6], 0.0, &rows(6, &[&row(PARTS, &[0.9, 2.0])]))).entry("head", "RTDETRDecoder"),
    nothing, "c2", STRETCHED
)]
#[case::yolo_nas_flat(
    Planted::default().bytes_input("input", &INPUT).output(
        "graph2_flat_predictions", &[-1, 7], &[1, 7], 0.0,
        &rows(7, &[&[0.0, 270.0, 290.0, 370.0, 350.0, 0.9, 2.0]]),
    ),
    coco, "car", IN_MARGINS
)]
#[case::yolo_nas_raw(
    Planted::default().input("input", &INPUT)
        .output("913", &[1, 8400, 4], &[1, 8400, 4], 0.0, &rows(4, &[&CORNERS]))
        .output("904", &[1, 8400, 80], &[1, 8400, 80], 0.0, &[(2, 0.9)]),
    nothing, "car", IN_MARGINS
)]
#[case::yolov7_with_suppression(
    Planted::default().input("images", &INPUT).output(
        "output", &[-1, 7], &[1, 7], 0.0, &rows(7, &[&[0.0, 270.0, 290.0, 370.0, 350.0, 2.0, 0.9]]),
    ),
    coco, "car", IN_MARGINS
)]
#[case::d_fine(
    Planted::default().input("images", &[-1, 3, 640, 640]).whole_input("orig_target_sizes", &[-1, 2])
        .whole_output("labels", &[1, 300], 2)
        .output("boxes", &[1, 300, 4], &[1, 300, 4], 0.0, &rows(4, &[&CORNERS]))
        .output("scores", &[1, 300], &[1, 300], 0.0, &[(0, 0.9)]),
    coco, "car", STRETCHED
)]
#[test]
#[ignore = "needs ONNX Runtime"]
fn a_familys_export_gives_the_box_where_it_lies_in_the_picture(
    #[case] planted: Planted,
    #[case] change: Change,
    #[case] class: &str,
    #[case] corners: [f64; 4],
) {
    let folder = tempfile::tempdir().unwrap();
    let mut network = open(planted.write(folder.path()), &[change]).unwrap();
    assert_found(&mut network, &[(class, corners)]);
}

#[rstest::rstest]
#[test]
#[ignore = "needs ONNX Runtime"]
fn a_model_gets_the_size_of_its_picture_in_any_form_that_exporters_write(
    #[values(INT64, INT32, FLOAT)] element: u64,
    #[values(&[1, 2], &[2])] shape: &[i64],
) {
    let boxes = rows(4, &[&CORNERS]);
    let planted = Planted::default()
        .input("images", &INPUT)
        .input_of(element, "orig_target_sizes", shape)
        .whole_output("labels", &[1, 300], 2)
        .output("boxes", &[1, 300, 4], &[1, 300, 4], 0.0, &boxes)
        .output("scores", &[1, 300], &[1, 300], 0.0, &[(0, 0.9)]);
    let folder = tempfile::tempdir().unwrap();
    let mut network = open(planted.write(folder.path()), &[coco]).unwrap();
    assert_found(&mut network, &[("car", STRETCHED)]);
}

#[rstest::rstest]
#[test]
#[ignore = "needs ONNX Runtime"]
fn class_numbers_are_read_from_whole_numbers_of_any_width(
    #[values(UINT8, INT8, UINT16, INT16, UINT32, INT32, INT64)] element: u64,
) {
    let boxes = rows(4, &[&CORNERS]);
    let planted = Planted::default()
        .input("image", &INPUT)
        .output("boxes", &[1, 300, 4], &[1, 300, 4], 0.0, &boxes)
        .output("scores", &[1, 300], &[1, 300], 0.0, &[(0, 0.9)])
        .output_of(element, "class_idx", &[1, 300], 2);
    let columns: Change = |config| {
        let columns = "columns=boxes: x1 y1 x2 y2, scores: score, class_idx: class";
        config.head = columns.parse().unwrap();
    };
    let folder = tempfile::tempdir().unwrap();
    let mut network = open(planted.write(folder.path()), &[coco, columns]).unwrap();
    assert_found(&mut network, &[("car", IN_MARGINS)]);
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn only_numbers_that_are_not_finite_are_laid_to_half_precision() {
    let folder = tempfile::tempdir().unwrap();
    for (score, is_said) in [(f32::NAN, true), (90.0, false)] {
        let column = |number: usize, value: f32| (number * 8400 + 7, value);
        let mut places = vec![column(6, score)];
        places.extend(CENTRED.into_iter().enumerate().map(|(number, side)| column(number, side)));
        let planted = one("output0", &[1, 84, 8400], 0.0, &places);
        let mut network = open(planted.write(folder.path()), &[]).unwrap();
        let black = network.preparation().prepare(&Picture::black(SIZE)).unwrap();
        let fault = (0..5).find_map(|_| network.detect(&black).err()).unwrap().to_string();
        assert_eq!(fault.contains("half precision"), is_said, "{fault}");
    }
}

/// What a refused model is told, the change that the words ask for, and what is then found.
#[rstest::rstest]
#[case::rt_detr_of_transformers(
    Planted::default().input("pixel_values", &[-1, -1, -1, -1])
        .output("logits", &[-1, -1, 80], &[1, 300, 80], -8.0, &[(2, 3.0)])
        .output("pred_boxes", &[-1, -1, 4], &[1, 300, 4], 0.0, &rows(4, &[&PARTS])),
    nothing, &["\"rt-detr\"", "detector.input_size"],
    |config: &mut DetectorConfig| {
        config.head = "rt-detr".parse().unwrap();
        config.input_size = Some([640, 640]);
    },
    STRETCHED
)]
#[case::rtmdet(
    Planted::default().input("input", &[-1, 3, -1, -1])
        .output("dets", &[-1, -1, 5], &[1, 1, 5], 0.0, &rows(5, &[&row(CORNERS, &[0.9])]))
        .whole_output("labels", &[1, 1], 2),
    coco, &["\"rtmdet\"", "detector.input_size"],
    |config: &mut DetectorConfig| {
        config.head = "rtmdet".parse().unwrap();
        config.input_size = Some([640, 640]);
    },
    IN_CORNER
)]
#[case::damo_yolo(
    one("output", &[1, 8400, 80], 0.0, &[(2, 0.9)])
        .output("1117", &[1, 8400, 4], &[1, 8400, 4], 0.0, &rows(4, &[&CORNERS])),
    nothing, &["\"yolo-nas\"", "\"0..255\"", "\"letterbox-corner\""],
    |config: &mut DetectorConfig| {
        config.head = "yolo-nas".parse().unwrap();
        config.range = Some(ValueRange::To255);
        config.fit = Some(Fit::TopLeft);
    },
    IN_CORNER
)]
#[case::decoded_grid_of_an_unknown_exporter(
    one("any", &[1, 8400, 85], 0.0, &rows(85, &[&third_class(&row(CENTRED, &[0.95]), 0.9)])),
    nothing, &["\"yolov5\"", "\"yolox\"", "detector.head"],
    |config: &mut DetectorConfig| config.head = "yolov5".parse().unwrap(),
    IN_MARGINS
)]
#[case::paddle(
    Planted::default().input("image", &INPUT).input("scale_factor", &[-1, 2])
        .output("nms.tmp_0", &[-1, 6], &[1, 6], 0.0, &rows(6, &[&[2.0, 0.9, 270.0, 290.0, 370.0, 350.0]]))
        .whole_output("nms.tmp_2", &[1], 1),
    coco, &["nms.tmp_0: class score x1 y1 x2 y2", "stretch"],
    |config: &mut DetectorConfig| {
        config.head = "columns=nms.tmp_0: class score x1 y1 x2 y2".parse().unwrap();
        config.fit = Some(Fit::Stretch);
    },
    STRETCHED
)]
#[case::ssd_of_tensorflow(
    Planted::default().bytes_input("image_tensor:0", &[-1, -1, -1, 3])
        .output("detection_boxes:0", &[1, 100, 4], &[1, 100, 4], 0.0,
            &rows(4, &[&[290.0 / 640.0, 270.0 / 640.0, 350.0 / 640.0, 370.0 / 640.0]]))
        .output("detection_scores:0", &[1, 100], &[1, 100], 0.0, &[(0, 0.9)])
        .output("detection_classes:0", &[1, 100], &[1, 100], 0.0, &[(0, 2.0)]),
    coco, &["detection_boxes:0: y1 x1 y2 x2", "detector.input_size"],
    |config: &mut DetectorConfig| {
        let columns = "columns=detection_boxes:0: y1 x1 y2 x2, detection_scores:0: score, detection_classes:0: class";
        config.head = columns.parse().unwrap();
        config.fit = Some(Fit::Stretch);
        config.range = Some(ValueRange::To255);
        config.input_size = Some([640, 640]);
    },
    STRETCHED
)]
#[case::columns_in_another_order(
    one("output", &[1, 50, 7], 0.0, &rows(7, &[&[2.0, 0.9, 270.0, 290.0, 370.0, 350.0, 5.0]])),
    coco, &["detector.head"],
    |config: &mut DetectorConfig| config.head = "columns=class score x1 y1 x2 y2 _".parse().unwrap(),
    IN_MARGINS
)]
#[test]
#[ignore = "needs ONNX Runtime"]
fn a_model_that_is_refused_is_read_with_the_settings_that_the_refusal_names(
    #[case] planted: Planted,
    #[case] change: Change,
    #[case] said: &[&str],
    #[case] remedy: Change,
    #[case] corners: [f64; 4],
) {
    let folder = tempfile::tempdir().unwrap();
    let file = planted.write(folder.path());
    let refusal = open(file.clone(), &[change]).err().unwrap();
    assert_contains(&refusal, said);
    let mut network = open(file, &[change, remedy]).unwrap();
    assert_found(&mut network, &[("car", corners)]);
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn what_was_assumed_of_a_model_is_said_where_its_reading_is_unless_it_was_configured() {
    let folder = tempfile::tempdir().unwrap();
    let shape = [1, 8400, 85];
    let car = third_class(&row(CENTRED, &[1.0]), 0.9);
    let yolov6 = one("outputs", &shape, 0.0, &rows(85, &[&car])).write(folder.path());
    let said = open(yolov6.clone(), &[]).unwrap().description();
    assert_contains(&said, &["head yolov5", "set detector.head", "\"yolox\""]);
    let configured: Change = |config| config.head = "yolov5".parse().unwrap();
    let said = open(yolov6, &[configured]).unwrap().description();
    assert!(!said.contains("set detector.head"), "{said}");
    let detr = Planted::default()
        .input("input", &INPUT)
        .output("dets", &[1, 300, 4], &[1, 300, 4], 0.0, &[])
        .output("labels", &[1, 300, 3], &[1, 300, 3], -5.0, &[])
        .entry("names", "{0: 'car', 1: 'bus'}");
    let said = open(detr.write(folder.path()), &[]).unwrap().description();
    assert_contains(
        &said,
        &["class 2, the last of 0 to 2", "detector.class_names"],
    );
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_model_of_ones_own_reports_all_its_classes_and_one_of_coco_those_of_the_paper_and_counts_the_rest()
 {
    let folder = tempfile::tempdir().unwrap();
    let plant = |classes: i64| {
        let shape = [1, 4 + classes, 8400];
        let mut places = Vec::new();
        for class in 0..classes.min(4) as usize {
            let sides = [100.0 + 120.0 * class as f32, 320.0, 60.0, 40.0];
            places.extend(sides.iter().enumerate().map(|(at, &side)| (at * 8400 + class, side)));
            places.push(((4 + class) * 8400 + class, 0.9));
        }
        one("output0", &shape, 0.0, &places)
    };
    let default: Change = |config| config.report_classes = None;
    let own = plant(4).entry(
        "names",
        "{0: 'helmet', 1: 'no-helmet', 2: 'vest', 3: 'person'}",
    );
    let mut network = open(own.write(folder.path()), &[default]).unwrap();
    assert_eq!(found(&mut network).len(), 4);
    assert_eq!(network.left_out(), [""; 0]);
    // Of person, bicycle, car and motorcycle all are the paper's; of the next two, one is.
    let mut network = open(plant(80).write(folder.path()), &[default]).unwrap();
    assert_eq!(network.class_names().len(), 7);
    assert_eq!(network.left_out().len(), 74);
    assert_eq!(found(&mut network).len(), 4);
    let only: Change = |config| config.report_classes = Some(vec!["car".to_owned()]);
    let mut network = open(plant(80).write(folder.path()), &[only]).unwrap();
    assert_eq!(found(&mut network).len(), 1);
    assert_eq!(network.counts().other_class, 3);
}

#[test]
#[ignore = "needs ../shared and ONNX Runtime"]
fn shared_every_handed_model_is_read_or_refused_with_its_remedy() {
    let model = |name: &str| shared(&format!("cases/models/{name}/model.onnx"));
    let all: Change = nothing;
    for (name, change, count) in [
        ("custom-classes-with-person", all, 4),
        ("home-camera", all, 4),
        ("deepstream-yolo", coco, 1),
        ("dfine", coco, 1),
        ("names-json-unicode", all, 2),
        ("nms-json", all, 1),
        (
            "rfdetr-4classes",
            |config| {
                config.class_names = Some(ClassNames::List(
                    ["a", "b", "c", "d"].map(str::to_owned).to_vec(),
                ))
            },
            1,
        ),
        ("ultralytics-rtdetr", all, 1),
        ("yolo-logits", all, 1),
        ("yolo-normalised", all, 1),
        ("yolo-transposed-nometa", all, 1),
        ("yolonas-flat", coco, 1),
        ("yolonas-raw", all, 0),
        ("yolov10-thu", all, 1),
        ("yolov5", all, 1),
        ("yolov6", all, 2),
        ("yolov7-end2end", coco, 1),
        ("yolov7-grid", all, 1),
        ("yolox-decoded", all, 2),
    ] {
        let mut network =
            open(model(name), &[change]).unwrap_or_else(|error| panic!("{name}: {error}"));
        let found = found(&mut network);
        // Cars of YOLOX lie below the picture in its corner of the input, or not.
        let is_right = found.len() == count || name == "yolox-decoded" && found.len() == 1;
        assert!(is_right, "{name}: {found:?}");
    }
    for (name, said) in [
        ("names-none", "class_names"),
        ("optimum-rtdetr", "\"rt-detr\""),
        ("ppyoloe", "class score x1 y1 x2 y2"),
        ("rtmdet-mmdeploy", "\"rtmdet\""),
        ("ssd-mobilenet-tf", "y1 x1 y2 x2"),
        ("yolov7-trt-nms", "without the plug-in"),
    ] {
        let refusal = open(model(name), &[]).err().unwrap_or_else(|| panic!("{name} was accepted"));
        assert_contains(&refusal, &[said]);
    }
    for (file, said) in [
        ("best.engine", "TensorRT"),
        ("best.pt", "format=onnx"),
        ("best.tflite", "TensorFlow Lite"),
        ("best_renamed.onnx", "format=onnx"),
        ("empty.onnx", "empty"),
        ("half.onnx", "cut short"),
        ("lfs.onnx", "git lfs pull"),
        ("model.xml", "OpenVINO"),
        ("page.onnx", "web page"),
    ] {
        let refusal = open(shared(&format!("cases/models/nomodel/{file}")), &[]).err().unwrap();
        assert_contains(&refusal, &[said]);
    }
}
