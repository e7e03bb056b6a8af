//! ONNX Runtime with tiny models: a fitting one runs, any other is rejected at the start with a helpful error.

use super::support::detectors::{
    CAMERA, assert_the_box, changed, config, detected, model, one_colour, refusal, started,
};
use super::support::{assert_contains, grey_jpeg, run_command};
use albireo_vision::detector::{
    CameraSlot, ClassNames, DetectorConfig, ExecutionProvider, HeadName, ModelStatus,
};
use albireo_vision::picture::{ColorOrder, ValueRange};
use albireo_vision::screen::{ScreenConfig, ScreenHandle};
use std::sync::Arc;

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_fitting_model_runs_on_the_pixels_of_the_picture_and_one_with_too_few_fails_alone() {
    let detector = started(&config("colours.onnx")).await;
    assert_eq!(detector.model_name(), "colours.onnx");
    assert_eq!(detector.class_names().len(), 7);
    assert_eq!(detector.provider(), ExecutionProvider::Cpu);
    // The class scores are the means of the colour planes; green is the second.
    assert_the_box(&detected(&detector, [51, 204, 0]).await, 1, 0.8);
    assert_eq!(detected(&detector, [100, 100, 100]).await, []);
    let mut short = Arc::unwrap_or_clone(one_colour([51, 204, 0]));
    short.pixels.pop();
    let error = detector.detect(CAMERA, Arc::new(short)).await.unwrap_err();
    assert_contains(&error.to_string(), &["24575"]);
    let is_ready = matches!(*detector.status().borrow(), ModelStatus::Ready { .. });
    assert!(is_ready);
    assert_the_box(&detected(&detector, [51, 204, 0]).await, 1, 0.8);
    assert_eq!(detector.counters().completed, 3);
    detector.stop().await;
}

fn nothing(_: &mut DetectorConfig) {}

#[rstest::rstest]
#[case::no_head("screen.onnx", nothing, &[
    "`logits` float32 [1, 2]", "is not recognised", "yolo: an output [1, 4 + classes, anchors]", "end-to-end:", "detr:",
    "yolox:", "fastestdet:",
])]
#[case::another_head("colours.onnx", |c: &mut DetectorConfig| c.head = HeadName::Yolox.into(), &["[1, 11, 1]", "`yolox`", "[1, 42, 5 + classes]"])]
#[case::truncated("truncated.onnx", nothing, &["cannot be loaded"])]
#[case::missing("missing.onnx", nothing, &["cannot be loaded"])]
#[case::foreign("make_models.py", nothing, &["cannot be loaded"])]
#[case::wrong_opset("wrong_opset.onnx", nothing, &["cannot be loaded", "opset"])]
#[case::wrong_for_any_provider("wrong_opset.onnx", |c: &mut DetectorConfig| c.providers = vec![ExecutionProvider::Cuda], &["cannot be loaded", "opset"])]
#[case::data_outside("outside.onnx", nothing, &["cannot be loaded"])]
#[case::too_large("large.onnx", nothing, &["is not recognised", "between 1 and 8192"])]
#[case::signed_bytes("yolo_signed.onnx", nothing, &[
    "the elements of its input are int8 instead of float32, float16 or uint8", "`images` int8 [1, 32, 64, 3]",
])]
#[case::too_much_memory("starving.onnx", nothing, &[
    "the first run of the model", "there is not enough memory", "562949953421568",
])]
#[case::no_class_names("yolo_float16.onnx", nothing, &["detector.class_names", "2 classes"])]
#[case::another_size("yolo_bytes.onnx", |c: &mut DetectorConfig| c.input_size = Some([128, 64]), &["64x32", "128x64"])]
#[case::one_picture_a_run("colours.onnx", |c: &mut DetectorConfig| c.batch_size = 3, &["detector.batch_size", "[1, 3, 32, 64]", "dynamic=True"])]
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn an_unusable_model_is_rejected_with_what_was_expected(
    #[case] file: &str,
    #[case] change: fn(&mut DetectorConfig),
    #[case] parts: &[&str],
) {
    let error = refusal(&changed(file, change)).await;
    assert_contains(&error, parts);
    // The error begins with the unusable setting, or else names the file.
    if parts[0].starts_with("detector.") {
        assert!(error.starts_with(parts[0]), "{error}")
    } else {
        assert_contains(&error, &[file])
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_range_has_no_effect_on_a_model_that_takes_bytes_which_is_said() {
    let of_floats = changed("yolo_bytes.onnx", |config| {
        config.range = Some(ValueRange::ToOne);
        config.class_names = Some(ClassNames::List(vec!["a".to_owned(), "b".to_owned()]));
    });
    let detector = started(&of_floats).await;
    let said = "detector.range = \"0..1\" is ignored";
    assert_contains(detector.description(), &[said]);
    detector.stop().await;
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
        let error = refusal(&of(providers)).await;
        assert_contains(&error, &[named, "detector.providers"]);
    }
    let detector = started(&of(&[TensorRt, Cuda, Cpu])).await;
    // The status shows the provider that runs, not the requested one.
    assert_eq!(detector.provider(), Cpu);
    let ready = ModelStatus::Ready { provider: Cpu };
    assert_eq!(*detector.status().borrow(), ready);
    // A node does not wait for TensorRT, and the provider after it goes on where there is none.
    let detector = started(&DetectorConfig {
        answers_while_building: true,
        ..of(&[TensorRt, Cpu])
    })
    .await;
    for _ in 0..3 {
        assert_the_box(&detected(&detector, [51, 204, 0]).await, 1, 0.8);
    }
    assert_eq!(*detector.status().borrow(), ready);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn the_screen_follows_its_class_and_colour_order_settings_and_takes_no_detector() {
    let start = async |model, color_order, empty_is_second| {
        let config = ScreenConfig {
            model,
            color_order,
            empty_is_second,
            ..ScreenConfig::default()
        };
        ScreenHandle::start(&config, None).await
    };
    // The fixture calls a picture empty while the mean of its first plane is below one half.
    let red = one_colour([255, 0, 0]);
    for (color_order, empty_is_second, empty) in [
        (ColorOrder::Rgb, false, false),
        (ColorOrder::Rgb, true, true),
        (ColorOrder::Bgr, false, true),
        (ColorOrder::Bgr, true, false),
    ] {
        let screen = start(Some(model("screen.onnx")), color_order, empty_is_second)
            .await
            .unwrap()
            .unwrap();
        let verdict = screen.ask(CAMERA, red.clone()).await.unwrap();
        assert_eq!(verdict.empty, empty, "{color_order:?} {empty_is_second}");
    }
    assert!(start(None, ColorOrder::Rgb, false).await.unwrap().is_none());
    let detector = start(Some(model("colours.onnx")), ColorOrder::Rgb, false).await;
    let said = ["colours.onnx", "[1, 11, 1]", "`screen`", "[1, 2]"];
    assert_contains(&detector.err().unwrap().to_string(), &said);
}

/// The model has a dynamic batch; red is the score of a car, green that of a traffic light.
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn cameras_share_a_run_and_each_gets_its_own_boxes() {
    let config = changed("yolo_open.onnx", |config| {
        config.report_classes = Some(Vec::new());
        config.confidence = 0.3;
        config.timeout_ms = 60_000;
        config.batch_size = 3;
    });
    let detector = started(&config).await;
    // They ask before the detector's task, on the same thread, looks for requests.
    let ask = |camera, color| {
        let picture = detector.preparation().prepare(&one_colour(color)).unwrap();
        detector.detect_prepared(CameraSlot(camera), picture)
    };
    let (one, two, three) = tokio::join!(
        ask(0, [204, 0, 0]),
        ask(1, [0, 153, 0]),
        ask(2, [102, 0, 0])
    );
    let found = [one, two, three].map(Result::unwrap);
    assert_the_box(&found[0].output.detections, 0, 0.8);
    assert_the_box(&found[1].output.detections, 1, 0.6);
    assert_the_box(&found[2].output.detections, 0, 0.4);
    // The time of the run is shared evenly among its pictures.
    let run = (3, found[0].took);
    assert_eq!(found.map(|one| (one.pictures, one.took)), [run; 3]);
}

/// Without recorded runs ONNX Runtime has nothing to send.
#[test]
#[ignore = "needs ONNX Runtime"]
fn onnx_runtime_writes_nothing_under_the_users_home() {
    let home = tempfile::tempdir().unwrap();
    let mut detect = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"));
    detect.arg("detect").arg(model("boxes.onnx"));
    detect.env("HOME", home.path());
    detect.env_remove("XDG_CACHE_HOME");
    run_command(detect.env_remove("ORT_DISABLE_TELEMETRY")).succeeds();
    assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 0);
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn pictures_whose_files_would_have_one_name_are_refused_before_any_is_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let detect = |pictures: [&str; 2]| {
        let mut detect = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"));
        detect
            .arg("detect")
            .arg(model("boxes.onnx"))
            .arg("--out")
            .arg(folder.path().join("seen"));
        for picture in pictures {
            let path = folder.path().join(picture);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, grey_jpeg(90, [32, 16])).unwrap();
            detect.arg(path);
        }
        run_command(&mut detect)
    };
    let said = detect(["a/1.jpg", "b/1.jpg"]).fails();
    assert_contains(&said, &["a/1.jpg", "b/1.jpg", "one name"]);
    assert!(!folder.path().join("seen").exists());
    detect(["a/1.jpg", "b/2.jpg"]).succeeds();
}
