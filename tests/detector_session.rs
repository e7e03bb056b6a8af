//! ONNX Runtime itself, on models of a few hundred bytes: a model that fits runs, any other is refused at the
//! start with a helpful error.

#![allow(clippy::panic)]

use super::support::assert_says;
use super::support::detectors::{assert_the_box, config, model, one_colour, refusal, started};
use albireo_vision::detector::{
    CameraSlot, DetectorConfig, DetectorStatus, ExecutionProvider, HeadName,
};
use albireo_vision::picture::ColorOrder;
use albireo_vision::screen::{ScreenConfig, ScreenHandle};
use rstest::rstest;
use std::sync::Arc;

const CAMERA: CameraSlot = CameraSlot(0);

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_fitting_model_is_run_on_the_pictures_own_pixels() {
    let detector = started(&config("colours.onnx")).await;
    assert_eq!(detector.model_name(), "colours.onnx");
    assert_eq!(detector.class_names().len(), 7);
    assert_eq!(detector.provider(), ExecutionProvider::Cpu);
    // Its class scores are the means of the planes: here green, the second.
    let answer = detector.detect(CAMERA, one_colour([51, 204, 0])).await;
    assert_the_box(&answer.unwrap(), 1, 0.8);
    // Nothing is bright enough here.
    let answer = detector.detect(CAMERA, one_colour([100, 100, 100])).await;
    assert!(answer.unwrap().detections.is_empty());
    assert_eq!(detector.counters().worker.completed, 2);
    detector.stop().await;
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn only_the_classes_to_report_are_reported() {
    let only = |names: &[&str]| DetectorConfig {
        report_classes: Some(names.iter().map(|&name| name.to_owned()).collect()),
        ..config("colours.onnx")
    };
    let picture = one_colour([51, 204, 0]);
    for (names, expected) in [(["rider"], 1), (["car"], 0)] {
        let detector = started(&only(&names)).await;
        let answer = detector.detect(CAMERA, picture.clone()).await.unwrap();
        assert_eq!(answer.detections.len(), expected, "{names:?}");
    }
    let error = refusal(&only(&["lorry"])).await;
    assert_says(&error, &["detector.report_classes", "lorry"]);
}

fn nothing(_: &mut DetectorConfig) {}

/// The file, what of it is configured, and what is said.
#[rstest]
#[case::no_head("screen.onnx", nothing, &[
    "`logits` float32 [1, 2]", "is not recognised", "yolo: one output [1, 4 + classes, anchors]", "end-to-end:", "detr:",
    "yolox:", "fastestdet:",
])]
#[case::another_head("colours.onnx", |c: &mut DetectorConfig| c.head = HeadName::Yolox, &["[1, 11, 1]", "`yolox`", "[1, 42, 5 + classes]"])]
#[case::truncated("truncated.onnx", nothing, &["cannot be loaded"])]
#[case::missing("missing.onnx", nothing, &["cannot be loaded"])]
#[case::foreign("make_models.py", nothing, &["cannot be loaded"])]
#[case::wrong_opset("wrong_opset.onnx", nothing, &["cannot be loaded", "opset"])]
#[case::data_outside("outside.onnx", nothing, &["cannot be loaded"])]
#[case::too_large("large.onnx", nothing, &["does not fit", "between 1 and 8192"])]
#[case::signed_bytes("yolo_signed.onnx", nothing, &[
    "the elements of its input are int8 instead of float32, float16 or uint8", "`images` int8 [1, 32, 64, 3]",
])]
#[case::too_much_memory("starving.onnx", nothing, &[
    "the first run of the model", "there is not enough memory", "562949953421568",
])]
#[case::one_picture_a_run("colours.onnx", |c: &mut DetectorConfig| c.batch_size = 3, &["detector.batch_size", "[1, 3, 32, 64]", "dynamic=True"])]
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_model_that_cannot_be_used_is_refused_with_what_was_looked_for(
    #[case] file: &str,
    #[case] change: fn(&mut DetectorConfig),
    #[case] parts: &[&str],
) {
    let mut config = config(file);
    change(&mut config);
    let error = refusal(&config).await;
    assert_says(&error, parts);
    assert_says(
        &error,
        &[if parts[0].starts_with("detector.") {
            parts[0]
        } else {
            file
        }],
    );
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_missing_provider_is_an_error_unless_the_list_has_another() {
    use ExecutionProvider::{Cpu, Cuda, TensorRt};
    let of = |providers: &[ExecutionProvider]| DetectorConfig {
        providers: providers.to_vec(),
        ..config("colours.onnx")
    };
    for (providers, named) in [
        (&[Cuda][..], "`cuda`"),
        (&[TensorRt], "`tensorrt`"),
        (&[TensorRt, Cuda], "`cuda`"),
    ] {
        assert_says(
            &refusal(&of(providers)).await,
            &[named, "detector.providers"],
        );
    }
    let detector = started(&of(&[TensorRt, Cuda, Cpu])).await;
    // The status shows the provider that runs, not the requested one.
    assert_eq!(detector.provider(), Cpu);
    let status = detector.status().borrow().clone();
    assert_eq!(status, DetectorStatus::Ready { provider: Cpu });
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn numbers_that_are_none_are_counted_and_reported_as_nothing() {
    let detector = started(&config("not_a_number.onnx")).await;
    let answer = detector.detect(CAMERA, one_colour([9, 9, 9])).await;
    assert!(answer.unwrap().detections.is_empty());
    assert_eq!(detector.counters().head.rejected, 1);
    assert_eq!(detector.counters().worker.failed, 0);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_picture_with_too_few_bytes_fails_alone() {
    let detector = started(&config("colours.onnx")).await;
    let mut short = Arc::unwrap_or_clone(one_colour([51, 204, 0]));
    short.pixels.pop();
    let error = detector.detect(CAMERA, Arc::new(short)).await.unwrap_err();
    assert_says(&error.to_string(), &["24575"]);
    let is_ready = matches!(*detector.status().borrow(), DetectorStatus::Ready { .. });
    assert!(is_ready);
    let answer = detector.detect(CAMERA, one_colour([51, 204, 0])).await;
    assert_eq!(answer.unwrap().detections.len(), 1);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn the_screen_says_empty_as_its_class_and_colour_order_have_it() {
    // The fixture calls a picture empty while the mean of its first plane is below one half.
    let screen = |color_order, empty_is_second| ScreenConfig {
        model: Some(model("screen.onnx")),
        color_order,
        empty_is_second,
        ..ScreenConfig::default()
    };
    let red = one_colour([255, 0, 0]);
    for (color_order, empty_is_second, empty) in [
        (ColorOrder::Rgb, false, false),
        (ColorOrder::Rgb, true, true),
        (ColorOrder::Bgr, false, true),
        (ColorOrder::Bgr, true, false),
    ] {
        let config = screen(color_order, empty_is_second);
        let screen = ScreenHandle::start(&config, None).await.unwrap().unwrap();
        let verdict = screen.ask(CAMERA, red.clone()).await.unwrap();
        assert_eq!(verdict.empty, empty, "{color_order:?} {empty_is_second}");
    }
    let none = ScreenHandle::start(&ScreenConfig::default(), None).await;
    assert!(none.unwrap().is_none());
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_detector_is_refused_as_a_screen() {
    let config = ScreenConfig {
        model: Some(model("colours.onnx")),
        ..ScreenConfig::default()
    };
    let error = ScreenHandle::start(&config, None).await.err().unwrap();
    assert_says(
        &error.to_string(),
        &["colours.onnx", "[1, 11, 1]", "`screen`", "[1, 2]"],
    );
}
