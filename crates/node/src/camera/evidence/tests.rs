//! One camera's evidence with a detector that finds coloured boxes: what is made ready ahead is used for its own frame.

use super::*;
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_vision::detector::DetectorConfig;
use albireo_vision::picture::FrameLimits;
use albireo_vision::screen::ScreenConfig;
use bytes::Bytes;
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
    LiveEvidence::new(detector.clone(), screen, slot, pixels)
}

/// What is found in `picture` by a camera that has seen nothing before.
async fn found_alone(picture: &EncodedPicture) -> Detected {
    let mut evidence = evidence().await;
    let detected = evidence.detect(picture, std::future::pending()).await;
    detected.unwrap().unwrap()
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn the_next_picture_is_made_ready_while_the_detector_looks_and_used_for_its_frame() {
    let [first, second, _] = pictures();
    let mut evidence = evidence().await;
    let next = std::future::ready((second.clone(), Need::Detections));
    let detected = evidence.detect(&first, next).await.unwrap().unwrap();
    assert_eq!(
        detected.detections,
        found_alone(&first).await.detections,
        "looking ahead does not change the current frame"
    );
    let prefetch = evidence.prefetch.as_ref().unwrap();
    assert!(prefetch.is_of(&second) && !prefetch.is_of(&first));

    evidence.next_frame();
    let next = std::future::pending();
    let detected = evidence.detect(&second, next).await.unwrap().unwrap();
    let alone = found_alone(&second).await;
    assert!(!alone.detections.is_empty());
    assert_eq!(detected.detections, alone.detections);
    // It did cost that time, only not now.
    assert!(evidence.times.decode.unwrap() > Duration::ZERO);
    assert!(evidence.times.letterbox.unwrap() > Duration::ZERO);
    assert!(evidence.prefetch.is_none());
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_picture_made_ready_whose_frame_never_comes_is_not_taken_for_another() {
    let [first, second, third] = pictures();
    let mut evidence = evidence().await;
    let next = std::future::ready((second, Need::Detections));
    evidence.detect(&first, next).await.unwrap();
    evidence.next_frame();
    let next = std::future::pending();
    let detected = evidence.detect(&third, next).await.unwrap().unwrap();
    assert_eq!(detected.detections, found_alone(&third).await.detections);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_broken_picture_made_ready_ahead_is_the_fault_of_its_own_frame() {
    let [first, second, _] = pictures();
    let broken = EncodedPicture {
        bytes: Bytes::copy_from_slice(&second.bytes[..second.bytes.len() / 2]),
        ..second.clone()
    };
    let mut evidence = evidence().await;
    let next = std::future::ready((broken.clone(), Need::Detections));
    assert!(evidence.detect(&first, next).await.unwrap().is_some());
    evidence.next_frame();
    let fault = evidence.detect(&broken, std::future::pending()).await;
    assert!(fault.is_err());
    evidence.next_frame();
    let detected = evidence.detect(&second, std::future::pending()).await;
    assert!(detected.unwrap().is_some());
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn decoded_pictures_of_all_cameras_take_turns_in_the_same_buffers() {
    let [first, second, third] = pictures();
    let detector = evidence().await.detector;
    let pixels = PixelWork::new(detector.preparation().clone(), FrameLimits::default(), 1);
    let mut cameras = [0; 4].map(|_| camera(&detector, pixels.clone()));
    for _ in 0..3 {
        for (picture, next) in [(&first, &second), (&second, &third), (&third, &first)] {
            for camera in &mut cameras {
                let next = std::future::ready((next.clone(), Need::Detections));
                assert!(camera.detect(picture, next).await.unwrap().is_some());
                camera.end_frame();
                camera.next_frame();
            }
        }
    }
    drop(cameras);
    // Not as many as cameras, each of which had one ahead besides.
    assert!(pixels.idle() <= 3, "{} buffers", pixels.idle());
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn what_was_made_ready_and_is_not_needed_is_given_back_with_its_frame() {
    let [first, second, _] = pictures();
    let mut evidence = evidence().await;
    let next = std::future::ready((second, Need::Detections));
    evidence.detect(&first, next).await.unwrap();
    evidence.end_frame();
    assert!(evidence.prefetch.is_some(), "its frame is to come");
    evidence.next_frame();
    assert!(evidence.begun.is_some(), "its frame has come");
    // The policy needed nothing.
    evidence.end_frame();
    assert!(evidence.begun.is_none() && evidence.prefetch.is_none());
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn who_waits_for_a_place_when_the_node_stops_waits_no_longer() {
    let [first, ..] = pictures();
    let give_up = CancellationToken::new();
    let mut evidence = evidence().await.giving_up_on(give_up.clone());
    let mut held = Vec::new();
    while let Some(Some(place)) = evidence.pixels.place().now_or_never() {
        held.push(place);
    }
    assert!(held.len() >= 3);
    let detecting = evidence.detect(&first, std::future::pending());
    tokio::pin!(detecting);
    assert!((&mut detecting).now_or_never().is_none());
    give_up.cancel();
    assert_eq!(detecting.await.unwrap(), None);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn while_the_detector_cannot_be_had_no_picture_is_decoded_for_it() {
    let [first, ..] = pictures();
    let mut evidence = evidence().await;
    evidence.detector.stop().await;
    let detected = evidence.detect(&first, std::future::pending()).await;
    assert_eq!(detected.unwrap(), None);
    assert_eq!(
        (evidence.times.decode, evidence.times.letterbox),
        (None, None)
    );
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_frame_uses_its_part_of_the_detectors_run_and_no_more() {
    let [first, ..] = pictures();
    let mut evidence = evidence().await;
    let detected = evidence.detect(&first, std::future::pending()).await;
    let took = detected.unwrap().unwrap().took;
    let run = evidence.times.detector_run.unwrap();
    assert_eq!(run.used, took);
    let (asked, answered) = evidence.times.detector_span.unwrap();
    assert!(asked + took <= run.end && run.end == answered);
    evidence.next_frame();
    assert_eq!(evidence.times.detector_run, None);
}
