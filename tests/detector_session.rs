//! ONNX Runtime itself, on models of a few hundred bytes: a model that fits runs, any other is refused at the
//! start with a helpful error.

#![allow(clippy::panic)]

use super::support::detectors::{PICTURE, config, model, one_colour};
use albireo_core::geometry::Corners;
use albireo_vision::detector::{
    CameraSlot, DetectorConfig, DetectorHandle, DetectorStatus, ExecutionProvider, HeadName,
};
use albireo_vision::picture::ColorOrder;
use albireo_vision::screen::{ScreenConfig, ScreenHandle};
use std::sync::Arc;

const CAMERA: CameraSlot = CameraSlot(0);

async fn refusal(config: DetectorConfig) -> String {
    match DetectorHandle::start(&config).await {
        Ok(_) => panic!("{config:?} was accepted"),
        Err(error) => error.to_string(),
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_fitting_model_is_run_on_the_pictures_own_pixels() {
    let detector = DetectorHandle::start(&config("colours.onnx"))
        .await
        .unwrap();
    assert_eq!(detector.model_name(), "colours.onnx");
    assert_eq!(detector.class_names().len(), 7);
    assert_eq!(detector.provider(), ExecutionProvider::Cpu);
    // Its class scores are the means of the planes: here green, the second.
    let answer = detector
        .detect(CAMERA, one_colour([51, 204, 0]))
        .await
        .unwrap();
    let [detection] = answer.detections.as_slice() else {
        panic!("{answer:?}");
    };
    assert_eq!(usize::from(detection.class.0), 1);
    assert!((detection.confidence - 0.8).abs() < 1e-5);
    let found = detection.bounding_box.pixel_corners(PICTURE);
    let expected = Corners {
        x1: 16.0,
        y1: 8.0,
        x2: 80.0,
        y2: 40.0,
    };
    for (found, expected) in [
        (found.x1, expected.x1),
        (found.y1, expected.y1),
        (found.x2, expected.x2),
        (found.y2, expected.y2),
    ] {
        assert!(
            (found - expected).abs() < 1e-6,
            "{found} instead of {expected}"
        );
    }
    // Nothing is bright enough here.
    let answer = detector
        .detect(CAMERA, one_colour([100, 100, 100]))
        .await
        .unwrap();
    assert!(answer.detections.is_empty());
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
        let detector = DetectorHandle::start(&only(&names)).await.unwrap();
        let answer = detector.detect(CAMERA, picture.clone()).await.unwrap();
        assert_eq!(answer.detections.len(), expected, "{names:?}");
    }
    let error = refusal(only(&["lorry"])).await;
    assert!(
        error.contains("detector.report_classes") && error.contains("lorry"),
        "{error}"
    );
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_model_that_no_head_or_not_the_named_one_reads_is_refused_with_what_was_looked_for() {
    let error = refusal(config("screen.onnx")).await;
    for part in [
        "screen.onnx",
        "`logits` float32 [1, 2]",
        "is not recognised",
        "yolo: one output [1, 4 + classes, anchors]",
        "end-to-end:",
        "detr:",
        "yolox:",
        "fastestdet:",
    ] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
    let error = refusal(DetectorConfig {
        head: HeadName::Yolox,
        ..config("colours.onnx")
    })
    .await;
    for part in [
        "colours.onnx",
        "[1, 11, 1]",
        "`yolox`",
        "[1, 42, 5 + classes]",
    ] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_truncated_missing_or_foreign_file_is_refused_with_its_name() {
    let text = DetectorConfig {
        model: model("make_models.py"),
        ..DetectorConfig::default()
    };
    for config in [config("truncated.onnx"), config("missing.onnx"), text] {
        let name = config.model.display().to_string();
        let error = refusal(config).await;
        assert!(
            error.contains(&name) && error.contains("cannot be loaded"),
            "{error}"
        );
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_missing_provider_is_an_error_unless_the_list_has_another() {
    use ExecutionProvider::{Cpu, Cuda, TensorRt};
    for (providers, named) in [(vec![Cuda], "`cuda`"), (vec![TensorRt], "`tensorrt`")] {
        let error = refusal(DetectorConfig {
            providers,
            ..config("colours.onnx")
        })
        .await;
        assert!(
            error.contains(named) && error.contains("detector.providers"),
            "{error}"
        );
    }
    let detector = DetectorHandle::start(&DetectorConfig {
        providers: vec![TensorRt, Cuda, Cpu],
        ..config("colours.onnx")
    })
    .await
    .unwrap();
    // The status shows the provider that runs, not the requested one.
    assert_eq!(detector.provider(), Cpu);
    assert_eq!(
        *detector.status().borrow(),
        DetectorStatus::Ready { provider: Cpu }
    );
    let error = refusal(DetectorConfig {
        providers: vec![TensorRt, Cuda],
        ..config("colours.onnx")
    })
    .await;
    assert!(error.contains("`cuda`"), "{error}");
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn numbers_that_are_none_are_counted_and_reported_as_nothing() {
    let detector = DetectorHandle::start(&config("not_a_number.onnx"))
        .await
        .unwrap();
    let answer = detector
        .detect(CAMERA, one_colour([9, 9, 9]))
        .await
        .unwrap();
    assert!(answer.detections.is_empty());
    assert_eq!(detector.counters().head.rejected, 1);
    assert_eq!(detector.counters().worker.failed, 0);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_picture_with_too_few_bytes_fails_alone() {
    let detector = DetectorHandle::start(&config("colours.onnx"))
        .await
        .unwrap();
    let mut short = Arc::unwrap_or_clone(one_colour([51, 204, 0]));
    short.pixels.pop();
    let error = detector.detect(CAMERA, Arc::new(short)).await.unwrap_err();
    assert!(error.to_string().contains("24575"), "{error}");
    assert!(matches!(
        *detector.status().borrow(),
        DetectorStatus::Ready { .. }
    ));
    let answer = detector
        .detect(CAMERA, one_colour([51, 204, 0]))
        .await
        .unwrap();
    assert_eq!(answer.detections.len(), 1);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn the_screen_says_empty_as_its_class_and_colour_order_have_it() {
    // The fixture calls a picture empty while the mean of its first plane is below one half.
    let screen = |color_order, empty_class| ScreenConfig {
        model: Some(model("screen.onnx")),
        color_order,
        empty_class,
        ..ScreenConfig::default()
    };
    let red = one_colour([255, 0, 0]);
    for (color_order, empty_class, empty) in [
        (ColorOrder::Rgb, 0, false),
        (ColorOrder::Rgb, 1, true),
        (ColorOrder::Bgr, 0, true),
        (ColorOrder::Bgr, 1, false),
    ] {
        let config = screen(color_order, empty_class);
        let screen = ScreenHandle::start(&config, None).await.unwrap().unwrap();
        let verdict = screen.ask(CAMERA, red.clone()).await.unwrap();
        assert_eq!(
            verdict.empty, empty,
            "{color_order:?} {empty_class} {verdict:?}"
        );
    }
    assert!(
        ScreenHandle::start(&screen(ColorOrder::Rgb, 2), None)
            .await
            .is_err()
    );
    let none = ScreenHandle::start(&ScreenConfig::default(), None).await;
    assert!(none.unwrap().is_none());
}

#[tokio::test]
async fn a_number_that_cannot_be_is_refused_with_its_key() {
    let good = || config("colours.onnx");
    for (key, config) in [
        (
            "detector.confidence",
            DetectorConfig {
                confidence: f64::NAN,
                ..good()
            },
        ),
        (
            "detector.suppression_overlap",
            DetectorConfig {
                suppression_overlap: 1.5,
                ..good()
            },
        ),
        (
            "detector.timeout_ms",
            DetectorConfig {
                timeout_ms: 0,
                ..good()
            },
        ),
        (
            "detector.batch_size",
            DetectorConfig {
                batch_size: 65,
                ..good()
            },
        ),
        (
            "detector.providers",
            DetectorConfig {
                providers: vec![],
                ..good()
            },
        ),
    ] {
        let error = refusal(config).await;
        assert!(error.starts_with(key), "{error}");
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_detector_is_refused_as_a_screen() {
    let config = ScreenConfig {
        model: Some(model("colours.onnx")),
        ..ScreenConfig::default()
    };
    let error = ScreenHandle::start(&config, None)
        .await
        .err()
        .unwrap()
        .to_string();
    for part in ["colours.onnx", "[1, 11, 1]", "`screen`", "[1, 2]"] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
}
