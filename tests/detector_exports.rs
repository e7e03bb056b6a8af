//! Model exports of many kinds through the whole detector: recognised and run, rejected, or survived.

use super::support::assert_contains;
use super::support::detectors::{
    CAMERA, assert_the_box, changed, config, detected, one_colour, refusal, started,
};
use albireo_core::geometry::PictureSize;
use albireo_vision::detector::{
    ClassNames, DetectorHandle, DetectorNetwork, HeadName, ModelStatus, RunError,
};
use albireo_vision::picture::Picture;

const NAMES: [&str; 2] = ["car", "traffic light"];

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_dynamic_export_has_the_size_and_classes_of_its_metadata_reported_as_configured() {
    let network = DetectorNetwork::open(&config("yolo_open.onnx")).unwrap();
    assert_eq!(network.head(), HeadName::Yolo);
    assert_eq!(network.input_format().size, PictureSize::new(64, 32));
    let all = changed("yolo_open.onnx", |all| all.report_classes = Some(vec![]));
    let detector = started(&all).await;
    assert_eq!(detector.class_names(), NAMES);
    assert_the_box(&detected(&detector, [51, 204, 0]).await, 1, 0.8);
    // A class that is not reported is left out, and counted.
    let cars = changed("yolo_open.onnx", |config| {
        config.report_classes = Some(vec!["car".to_owned()]);
    });
    let detector = started(&cars).await;
    assert_eq!(detected(&detector, [0, 204, 0]).await, []);
    assert!(detector.head_meter().read().other_class > 0);
    let detector = started(&config("yolo_open.onnx")).await;
    let class = async |detector: &DetectorHandle, color| {
        let found = detected(detector, color).await[0].class;
        detector.class_names()[usize::from(found.0)].to_owned()
    };
    assert_eq!(class(&detector, [204, 0, 0]).await, "car");
    let names = [("traffic light".to_owned(), "bus".to_owned())];
    let renamed = changed("yolo_open.onnx", |config| config.class_map = names.into());
    assert_eq!(class(&started(&renamed).await, [0, 204, 0]).await, "bus");
}

#[rstest::rstest]
#[case::of_ultralytics("yolo_unsaid.onnx", HeadName::Yolo)]
#[case::of_yolov5("yolov5_unsaid.onnx", HeadName::Yolov5)]
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn an_export_that_says_nothing_of_its_output_is_recognised_by_a_run(
    #[case] name: &str,
    #[case] head: HeadName,
) {
    let with_size = changed(name, |config| {
        config.input_size = Some([64, 32]);
        config.report_classes = Some(Vec::new());
    });
    let mut network = DetectorNetwork::open(&with_size).unwrap();
    assert!(network.signature().to_string().contains("[?, ?, ?]"));
    assert_eq!(network.head(), head);
    let detector = started(&with_size).await;
    assert_the_box(&detected(&detector, [51, 204, 0]).await, 1, 0.8);
    // At the smaller input of another picture there are fewer anchors. The box is at the same place of any input.
    let square = Picture::black(PictureSize::new(64, 64));
    let prepared = network.preparation().prepare(&square).unwrap();
    network.detect(&prepared).unwrap();
    let inputs = network.preparation().inputs();
    assert_eq!(inputs[0].smallest.size, PictureSize::new(32, 32));
    assert_eq!(inputs[0].choice.as_str(), "comparing", "{inputs:?}");
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn an_export_of_one_size_that_says_nothing_of_its_output_is_recognised_by_a_run() {
    let config = changed("yolo_fixed_unsaid.onnx", |config| {
        config.report_classes = Some(Vec::new());
    });
    let network = DetectorNetwork::open(&config).unwrap();
    assert!(network.signature().to_string().contains("[?, ?, ?]"));
    assert_eq!(network.head(), HeadName::Yolo);
    let detector = started(&config).await;
    assert_the_box(&detected(&detector, [51, 204, 0]).await, 1, 0.8);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn yolov5s_export_without_a_size_asks_for_it() {
    let refusal = refusal(&config("yolov5_unsaid.onnx")).await;
    assert_contains(&refusal, &["detector.input_size", "is open", "for example"]);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn float16_and_bytes_with_channels_last_give_the_results_of_float32() {
    for name in ["yolo_float16.onnx", "yolo_bytes.onnx"] {
        let named = changed(name, |config| {
            config.class_names = Some(ClassNames::List(NAMES.map(str::to_owned).to_vec()));
            config.report_classes = Some(Vec::new());
        });
        let detector = started(&named).await;
        assert_the_box(&detected(&detector, [204, 51, 0]).await, 0, 0.8);
        assert_the_box(&detected(&detector, [0, 153, 0]).await, 1, 0.6);
        assert_eq!(detected(&detector, [90, 90, 90]).await, []);
        assert_eq!(detector.head_meter().read(), Default::default());
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn impossible_unknown_and_outside_boxes_are_counted_and_the_valid_one_is_reported() {
    let detector = started(&config("end_to_end.onnx")).await;
    assert_the_box(&detected(&detector, [230, 0, 0]).await, 0, 0.902);
    let counts = detector.head_meter().read();
    let counted = [counts.rejected, counts.unknown_class, counts.outside];
    assert_eq!(counted, [1, 1, 1]);
    assert_eq!(detector.counters().failed, 0);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_model_that_returns_only_impossible_boxes_is_reported_and_recovers_by_itself() {
    const DARK: [u8; 3] = [51, 0, 0];
    let detector = started(&config("dark_overflows.onnx")).await;
    // A few bad runs in a row are tolerated, and a good one ends the row.
    for _ in 0..2 {
        for _ in 0..4 {
            assert_eq!(detected(&detector, DARK).await, []);
        }
        assert_the_box(&detected(&detector, [230, 0, 0]).await, 0, 0.902);
    }
    assert_eq!(detector.counters().failed, 0);
    for run in 0..6 {
        let answer = detector.detect(CAMERA, one_colour(DARK)).await;
        let is_ready = matches!(*detector.status().borrow(), ModelStatus::Ready { .. });
        assert_eq!((answer.is_ok(), is_ready), (run < 4, run < 4), "run {run}");
    }
    let status = detector.status().borrow().clone();
    assert_contains(status.fault().unwrap(), &["impossible"]);
    assert!(detector.accepts().is_ok(), "it still accepts frames");

    assert_the_box(&detected(&detector, [230, 0, 0]).await, 0, 0.902);
    assert_eq!(detector.status().borrow().fault(), None);
    let counts = detector.counters();
    assert_eq!((counts.failed, counts.rebuilds), (2, 0));
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn boxes_above_the_cap_are_counted_and_dropped() {
    for most in [42, 10] {
        let capped = changed("crowd.onnx", |config| config.most_detections = most);
        let detector = started(&capped).await;
        assert_eq!(detected(&detector, [204, 0, 0]).await.len(), most);
        assert_eq!(detector.head_meter().read().over_limit > 0, most < 42);
    }
}

/// A model that fails on a bright picture, the redness on which it works, the detections there, and parts of the error.
#[rstest::rstest]
#[case::too_little_memory("hungry.onnx", 102, 1, &[
    "there is not enough memory", "a smaller model or input size", "562949953421568",
])]
#[case::another_output_shape("changing.onnx", 51, 0, &["[1, 7, 42]"])]
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_failed_run_is_explained_and_counted_and_the_next_picture_is_answered(
    #[case] file: &str,
    #[case] red: u8,
    #[case] found: usize,
    #[case] parts: &[&str],
) {
    let dark = [red, 0, 0];
    let detector = started(&changed(file, |config| config.confidence = 0.3)).await;
    assert_eq!(detected(&detector, dark).await.len(), found);
    let bright = detector.detect(CAMERA, one_colour([255, 0, 0])).await;
    let error = bright.unwrap_err();
    assert!(matches!(error, RunError::Failed(_)), "{error}");
    assert_contains(&error.to_string(), parts);
    let is_ready = |status: &ModelStatus| matches!(status, ModelStatus::Ready { .. });
    detector.status().wait_for(is_ready).await.unwrap();
    assert_eq!(detected(&detector, dark).await.len(), found);
    let counts = detector.counters();
    assert_eq!((counts.completed, counts.failed), (2, 1));
    assert_eq!((counts.rebuilds, counts.panicked), (1, 0));
}
