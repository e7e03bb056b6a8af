//! One camera's evidence with a detector that finds coloured boxes.

use super::*;
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_vision::detector::DetectorConfig;
use albireo_vision::picture::FrameLimits;
use albireo_vision::screen::ScreenConfig;
use futures_util::FutureExt;
use std::path::Path;

/// Pictures of boxes.
fn pictures() -> [EncodedPicture; 3] {
    let size = PictureSize::new(640, 360);
    let scene = BoxScene::new(5, size);
    [0, 10, 30].map(|index| EncodedPicture {
        format: albireo_vision::picture::PictureFormat::Jpeg,
        bytes: scene.frame(index).jpeg(90).unwrap().into(),
        size,
    })
}

async fn evidence() -> LiveEvidence {
    let config = DetectorConfig {
        model: Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/models/boxes.onnx"),
        confidence: 0.1,
        timeout_ms: 60_000,
        ..DetectorConfig::default()
    };
    let detector = DetectorHandle::start(&config).await.unwrap();
    let pixels = PixelWork::new(detector.preparation().clone(), FrameLimits::default(), 1);
    camera(&detector, pixels)
}

fn camera(detector: &DetectorHandle, pixels: PixelWork) -> LiveEvidence {
    let slot = CameraSlot(0);
    let screen = CameraScreen::new(&ScreenConfig::default(), None);
    let never = CancellationToken::new();
    LiveEvidence::new(detector.clone(), screen, slot, pixels, never)
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn decoded_pictures_of_all_cameras_share_the_same_buffers() {
    let [first, second, third] = pictures();
    let detector = evidence().await.detector;
    let pixels = PixelWork::new(detector.preparation().clone(), FrameLimits::default(), 1);
    let mut cameras = [0; 4].map(|_| camera(&detector, pixels.clone()));
    for _ in 0..3 {
        for picture in [&first, &second, &third] {
            for camera in &mut cameras {
                assert!(camera.detect(picture).await.unwrap().is_some());
                camera.end_frame();
                camera.next_frame();
            }
        }
    }
    drop(cameras);
    // Fewer than there are cameras.
    assert!(pixels.idle() <= 3, "{} buffers", pixels.idle());
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_wait_for_a_place_ends_when_the_node_stops() {
    let [first, ..] = pictures();
    let mut evidence = evidence().await;
    let give_up = evidence.give_up.clone();
    let mut held = Vec::new();
    while let Some(Some(place)) = evidence.pixels.place().now_or_never() {
        held.push(place);
    }
    assert!(held.len() >= 3);
    let detecting = evidence.detect(&first);
    tokio::pin!(detecting);
    assert!((&mut detecting).now_or_never().is_none());
    give_up.cancel();
    assert_eq!(detecting.await.unwrap(), None);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn no_picture_is_decoded_for_an_unavailable_detector() {
    let [first, ..] = pictures();
    let mut evidence = evidence().await;
    evidence.detector.stop().await;
    let detected = evidence.detect(&first).await;
    assert_eq!(detected.unwrap(), None);
    let latency = evidence.times().latency;
    assert_eq!((latency.decode, latency.detector), (None, None));
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_frame_is_charged_only_its_share_of_the_detector_run() {
    let [first, ..] = pictures();
    let mut evidence = evidence().await;
    let detected = evidence.detect(&first).await;
    let took = detected.unwrap().unwrap().took;
    let run = evidence.times().detector_run.unwrap();
    assert_eq!(run.used, took);
    let latency = evidence.times().latency;
    assert!(latency.detector.unwrap() >= milliseconds(took));
    assert!(latency.decode.unwrap() > 0.0);
    evidence.next_frame();
    assert_eq!(evidence.times().detector_run, None);
}
