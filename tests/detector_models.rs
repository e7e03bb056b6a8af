//! Real models on real frames find what their README says.

#![allow(clippy::expect_used)]

use super::support::shared;
use albireo_core::geometry::PictureSize;
use albireo_vision::detector::{CameraSlot, ClassNames, Detected, DetectorConfig, DetectorHandle};
use albireo_vision::picture::{ColorOrder, Picture, PixelLayout};
use albireo_vision::screen::{ScreenConfig, ScreenHandle};
use std::process::Command;
use std::sync::Arc;

const CAMERA: CameraSlot = CameraSlot(0);

/// Frame `number` (from 0) of a clip of `size`, decoded by ffmpeg.
fn frame(clip: &str, number: u32, size: PictureSize) -> Arc<Picture> {
    let output = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(shared(&format!("media/{clip}")))
        .args(["-vf", &format!("select=eq(n\\,{number})")])
        .args(["-frames:v", "1", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"])
        .output()
        .expect("this test needs the program ffmpeg (Debian package ffmpeg)");
    assert!(
        output.status.success(),
        "ffmpeg failed: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let bytes = size.pixels() * 3;
    assert_eq!(
        output.stdout.len() as u64,
        bytes,
        "frame {number} of {clip}"
    );
    Arc::new(Picture {
        size,
        source_size: size,
        layout: PixelLayout::Rgb8,
        pixels: output.stdout,
    })
}

/// Asserts that a detection of `class` is within 2 px and 0.01 of what the model's README says.
fn assert_found(
    detector: &DetectorHandle,
    detected: &Detected,
    size: PictureSize,
    (class, score, box_in_pixels): (&str, f64, [f64; 4]),
) {
    let fits = detected.detections.iter().any(|detection| {
        let corners = detection.bounding_box.pixel_corners(size);
        let found = [corners.x1, corners.y1, corners.x2, corners.y2];
        detector.class_names()[usize::from(detection.class.0)] == class
            && (detection.confidence - score).abs() <= 0.01
            && found
                .iter()
                .zip(box_in_pixels)
                .all(|(found, expected)| (found - expected).abs() <= 2.0)
    });
    assert!(
        fits,
        "no {class} {score} {box_in_pixels:?} among {:?}",
        detected
            .detections
            .iter()
            .map(|detection| (
                detection.class,
                detection.confidence,
                detection.bounding_box.pixel_corners(size)
            ))
            .collect::<Vec<_>>()
    );
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ../shared and ONNX Runtime and ffmpeg"]
async fn shared_yolox_finds_the_two_cars_of_its_readme() {
    let size = PictureSize::new(720, 576);
    let detector = DetectorHandle::start(&DetectorConfig {
        model: shared("models/yolox_nano_416.onnx"),
        ..DetectorConfig::default()
    })
    .await
    .unwrap();
    let picture = frame("highway_two_cars.mp4", 60, size);
    let detected = detector.detect(CAMERA, picture).await.unwrap();
    assert_eq!(detector.model_name(), "yolox_nano_416.onnx");
    let right = ("car", 0.88, [554.0, 324.0, 659.0, 396.0]);
    let left = ("car", 0.82, [455.0, 325.0, 528.0, 396.0]);
    assert_found(&detector, &detected, size, right);
    assert_found(&detector, &detected, size, left);
    assert_eq!(detected.detections.len(), 2, "{:?}", detected.detections);
    detector.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ../shared and ONNX Runtime and ffmpeg"]
async fn shared_fastestdet_finds_the_two_cars_of_its_readme() {
    let size = PictureSize::new(720, 576);
    let detector = DetectorHandle::start(&DetectorConfig {
        model: shared("models/fastestdet_352.onnx"),
        class_names: Some(ClassNames::File(shared("models/coco80.txt"))),
        // As its README has it: below, it finds what is not there.
        confidence: 0.6,
        ..DetectorConfig::default()
    })
    .await
    .unwrap();
    let picture = frame("highway_two_cars.mp4", 60, size);
    let detected = detector.detect(CAMERA, picture).await.unwrap();
    let right = ("car", 0.88, [558.0, 320.0, 662.0, 398.0]);
    let left = ("car", 0.83, [463.0, 325.0, 528.0, 401.0]);
    assert_found(&detector, &detected, size, right);
    assert_found(&detector, &detected, size, left);
    detector.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ../shared and ONNX Runtime and ffmpeg"]
async fn shared_the_upstream_screen_gives_the_logits_of_its_readme() {
    let size = PictureSize::new(768, 432);
    let screen = ScreenHandle::start(
        &ScreenConfig {
            model: Some(shared("models/erd_upstream.onnx")),
            color_order: ColorOrder::Bgr,
            ..ScreenConfig::default()
        },
        None,
    )
    .await
    .unwrap()
    .unwrap();
    for (number, expected) in [
        (5, [0.894, -0.866]),
        (100, [-21.069, 16.689]),
        (200, [-29.538, 25.955]),
    ] {
        let picture = frame("fixed_topdown_cars.mp4", number, size);
        let verdict = screen.ask(CAMERA, picture).await.unwrap();
        assert_eq!(verdict.empty, number == 5);
        for (logit, expected) in verdict.logits.into_iter().zip(expected) {
            let allowed = 0.05 + 0.01 * f32::abs(expected);
            assert!(
                (logit - expected).abs() <= allowed,
                "frame {number}: {:?} instead of {expected:?}",
                verdict.logits
            );
        }
    }
    screen.stop().await;
}
