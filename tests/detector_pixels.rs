//! A model that a GPU may run is given pixels, which a small graph in front of it converts: it finds the same in them as in
//! pictures that the processor converts. Where no GPU is, the processor runs that graph, too.

use super::support::detectors::{config, decoded, one_colour, started};
use super::support::project;
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_eval::footage::{FrameSource, Pictures};
use albireo_vision::detector::{
    CameraSlot, Choice, ClassNames, DetectorConfig, DetectorNetwork, ExecutionProvider,
};
use albireo_vision::picture::{InputElement, Picture, ValueRange};
use rstest::rstest;

/// Opens the same model with the graph in front of it, and without.
fn both(config: &DetectorConfig) -> [DetectorNetwork; 2] {
    let mut on_gpu = config.clone();
    on_gpu.providers = vec![ExecutionProvider::Cuda, ExecutionProvider::Cpu];
    let mut without = on_gpu.clone();
    without.gpu.processor_converts = true;
    [on_gpu, without].map(|config| DetectorNetwork::open(&config).unwrap())
}

fn two_classes() -> ClassNames {
    ClassNames::List(vec!["car".to_owned(), "traffic light".to_owned()])
}

fn boxes(network: &mut DetectorNetwork, picture: &Picture) -> Vec<Detection> {
    let prepared = network.preparation().prepare(picture).unwrap();
    network.detect(&prepared).unwrap().detections
}

/// The pictures of the demonstration's road.
fn road(count: usize) -> Vec<Picture> {
    let mut road = Pictures::of_archive(&project("demo/road.tar"), 25.0).unwrap();
    let encoded = std::iter::from_fn(|| road.next().unwrap());
    encoded.take(count).map(|encoded| decoded(&encoded)).collect()
}

fn takes_pixels(network: &DetectorNetwork) -> bool {
    let format = network.preparation().format();
    format.element == InputElement::Byte && format != network.input_format()
}

/// Asserts that both find the same: every pair within a pixel of the input, and a hundredth of confidence.
#[track_caller]
fn assert_same(one: &[Detection], other: &[Detection], input: PictureSize) {
    assert_eq!(one.len(), other.len(), "{one:?} {other:?}");
    for (one, other) in one.iter().zip(other) {
        assert_eq!(one.class, other.class);
        assert!((one.confidence - other.confidence).abs() < 0.01);
        let corners = [one, other].map(|found| found.bounding_box.pixel_corners(input));
        let [a, b] = corners.map(|corner| [corner.x1, corner.y1, corner.x2, corner.y2]);
        for (a, b) in a.into_iter().zip(b) {
            assert!((a - b).abs() < 1.0, "{one:?} {other:?}");
        }
    }
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn the_road_has_the_same_boxes_at_the_largest_input_and_at_the_smallest() {
    let mut config = config("colours.onnx");
    config.model = project("models/yolox_nano.onnx");
    let [mut pixels, mut values] = both(&config);
    assert!(takes_pixels(&pixels) && !takes_pixels(&values));
    let mut found = 0;
    for picture in road(40) {
        let boxes = [&mut pixels, &mut values].map(|network| boxes(network, &picture));
        assert_same(&boxes[0], &boxes[1], pixels.input_format().size);
        found += boxes[0].len();
    }
    assert!(found > 20, "{found} boxes");
    let [one, other] = [&pixels, &values].map(|network| network.preparation().inputs());
    assert_eq!(one, other);
    assert!(matches!(one[0].choice, Choice::Smallest(_)), "{one:?}");
}

#[rstest]
#[case::zero_to_one("yolo_open.onnx", None)]
#[case::of_imagenet("yolo_open.onnx", Some(ValueRange::ImageNet))]
#[case::in_half_precision("yolo_float16.onnx", None)]
#[case::of_another_family("colours.onnx", None)]
#[test]
#[ignore = "needs ONNX Runtime"]
fn a_model_of_any_range_and_element_finds_the_same(
    #[case] model: &str,
    #[case] range: Option<ValueRange>,
) {
    let mut config = config(model);
    config.range = range;
    if model == "yolo_float16.onnx" {
        config.class_names = Some(two_classes());
    }
    config.confidence = 0.1;
    config.report_classes = Some(Vec::new());
    let [mut pixels, mut values] = both(&config);
    assert!(takes_pixels(&pixels) && !takes_pixels(&values));
    for colour in [[51, 204, 0], [204, 0, 0], [0, 204, 51]] {
        let picture = one_colour(colour);
        let boxes = [&mut pixels, &mut values].map(|network| boxes(network, &picture));
        assert_same(&boxes[0], &boxes[1], pixels.input_format().size);
    }
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_model_that_takes_bytes_gets_them_without_a_detour() {
    let mut config = config("yolo_bytes.onnx");
    config.class_names = Some(two_classes());
    config.report_classes = Some(Vec::new());
    let network = DetectorNetwork::open(&config).unwrap();
    assert_eq!(network.preparation().format().element, InputElement::Byte);
    let [mut pixels, mut values] = both(&config);
    let picture = one_colour([51, 204, 0]);
    let boxes = [&mut pixels, &mut values].map(|network| boxes(network, &picture));
    assert_same(&boxes[0], &boxes[1], pixels.input_format().size);
    assert_eq!(boxes[0].len(), 1);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn cameras_that_share_a_run_each_get_their_own_boxes() {
    let mut config = config("yolo_open.onnx");
    config.providers = vec![ExecutionProvider::Cuda, ExecutionProvider::Cpu];
    config.batch_size = 4;
    config.report_classes = Some(Vec::new());
    let detector = started(&config).await;
    let colours = [[204, 0, 0], [51, 204, 0], [204, 0, 0], [51, 204, 0]];
    let mut cameras = Vec::new();
    for (camera, (colour, class)) in colours.into_iter().zip([0, 1, 0, 1]).enumerate() {
        let detector = detector.clone();
        cameras.push(tokio::spawn(async move {
            let mut was_shared = false;
            for _ in 0..20 {
                let answer = detector.detect(CameraSlot(camera), one_colour(colour)).await.unwrap();
                let [found] = answer.output.detections.as_slice() else {
                    panic!("not one box: {answer:?}");
                };
                assert_eq!(found.class.0, class);
                was_shared |= answer.pictures > 1;
            }
            was_shared
        }));
    }
    let mut was_shared = false;
    for camera in cameras {
        was_shared |= camera.await.unwrap();
    }
    assert!(was_shared, "no run was shared");
    detector.stop().await;
}
