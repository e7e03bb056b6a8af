//! Real models on real frames find the objects in their README.

use super::support::detectors::{CAMERA, decoded};
use super::support::shared;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_eval::footage::{Ffmpeg, FrameSource, Video, VideoEncoding};
use albireo_vision::detector::{ClassNames, DetectorConfig, DetectorHandle};
use albireo_vision::picture::{ColorOrder, Picture};
use albireo_vision::screen::{ScreenConfig, ScreenHandle};
use std::sync::Arc;

/// Frame `number` (from 0) of a clip.
fn frame(clip: &str, number: usize) -> Arc<Picture> {
    let file = shared(&format!("media/{clip}"));
    let file = file.to_str().unwrap();
    let mut video = Video::open(file, None, VideoEncoding::Png, Ffmpeg::default()).unwrap();
    let mut frames = std::iter::from_fn(|| video.next().unwrap());
    Arc::new(decoded(&frames.nth(number).unwrap()))
}

#[rstest::rstest]
#[case::yolox("yolox_nano_416.onnx", None, 0.5, [
    (0.88, [554.0, 324.0, 659.0, 396.0]), (0.82, [455.0, 325.0, 528.0, 396.0]),
])]
// As its README says, it has false detections below 0.6.
#[case::fastestdet("fastestdet_352.onnx", Some("coco80.txt"), 0.6, [
    (0.88, [558.0, 320.0, 662.0, 398.0]), (0.83, [463.0, 325.0, 528.0, 401.0]),
])]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ../shared and ONNX Runtime and ffmpeg"]
async fn shared_a_model_finds_the_two_cars_of_its_readme(
    #[case] file: &str,
    #[case] names: Option<&str>,
    #[case] confidence: f64,
    #[case] cars: [(f64, [f64; 4]); 2],
) {
    let in_models = |file: &str| shared(&format!("models/{file}"));
    let config = DetectorConfig {
        model: in_models(file),
        class_names: names.map(|file| ClassNames::File(in_models(file))),
        confidence,
        ..DetectorConfig::default()
    };
    let detector = DetectorHandle::start(&config).await.unwrap();
    let picture = frame("highway_two_cars.mp4", 60);
    let size = picture.size;
    assert_eq!(size, PictureSize::new(720, 576));
    let detected = detector.detect(CAMERA, picture).await.unwrap();
    assert_eq!(detector.model_name(), file);
    for (score, place) in cars {
        let is_found = detected.output.detections.iter().any(|detection| {
            let Corners { x1, y1, x2, y2 } = detection.bounding_box.pixel_corners(size);
            let mut sides = [x1, y1, x2, y2].into_iter().zip(place);
            detector.class_names()[usize::from(detection.class.0)] == "car"
                && (detection.confidence - score).abs() <= 0.01
                && sides.all(|(found, expected)| (found - expected).abs() <= 2.0)
        });
        assert!(is_found, "no {score} {place:?} among {detected:?}");
    }
    let are_all = detected.output.detections.len() == 2;
    assert!(names.is_some() || are_all, "{detected:?}");
    detector.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ../shared and ONNX Runtime and ffmpeg"]
async fn shared_the_upstream_screen_gives_the_logits_of_its_readme() {
    let config = ScreenConfig {
        model: Some(shared("models/erd_upstream.onnx")),
        color_order: ColorOrder::Bgr,
        ..ScreenConfig::default()
    };
    let screen = ScreenHandle::start(&config, None).await.unwrap().unwrap();
    for (number, expected) in [
        (5, [0.894, -0.866]),
        (100, [-21.069, 16.689]),
        (200, [-29.538, 25.955]),
    ] {
        let picture = frame("fixed_topdown_cars.mp4", number);
        let verdict = screen.ask(CAMERA, picture).await.unwrap();
        assert_eq!(verdict.empty, number == 5);
        for (logit, expected) in verdict.logits.into_iter().zip(expected) {
            let tolerance = 0.05 + 0.01 * f32::abs(expected);
            let is_close = (logit - expected).abs() <= tolerance;
            assert!(is_close, "frame {number}: {logit} instead of {expected}");
        }
    }
    screen.stop().await;
}
