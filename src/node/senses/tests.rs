//! One camera's eyes with the demonstration detector: what is made ready ahead is used for its own frame.

use super::*;
use crate::detector::DetectorConfig;
use crate::geometry::PictureSize;
use crate::screen::ScreenConfig;
use crate::synth::{Dashcam, DashcamSettings};
use bytes::Bytes;
use std::path::Path;

/// Pictures of the synthetic dashcam.
fn pictures() -> [EncodedPicture; 3] {
    let size = PictureSize::new(640, 360);
    let mut dashcam = Dashcam::new(DashcamSettings {
        seed: 5,
        size,
        ..DashcamSettings::default()
    })
    .unwrap();
    [0, 40, 80].map(|index| EncodedPicture {
        format: crate::frame::PictureFormat::Jpeg,
        bytes: dashcam.frame(index).encode_jpeg(90).unwrap().into(),
        size,
    })
}

async fn senses() -> Senses {
    let config = DetectorConfig {
        model: Path::new(env!("CARGO_MANIFEST_DIR")).join("models/detector.onnx"),
        confidence: 0.1,
        timeout_ms: 60_000,
        ..DetectorConfig::default()
    };
    let slot = CameraSlot(0);
    Senses::new(
        DetectorHandle::start(&config).await.unwrap(),
        CameraScreen::new(&ScreenConfig::default(), None, slot),
        slot,
        FrameLimits::default(),
    )
}

/// What is found in `picture` by eyes that have seen nothing before.
async fn found_alone(picture: &EncodedPicture) -> Detected {
    let mut senses = senses().await;
    let detected = senses.detect(picture, std::future::pending()).await;
    detected.unwrap().unwrap()
}

#[tokio::test]
async fn the_next_picture_is_made_ready_while_the_detector_looks_and_used_for_its_frame() {
    let [first, second, _] = pictures();
    let mut senses = senses().await;
    let next = std::future::ready((second.clone(), Need::Detections));
    let detected = senses.detect(&first, next).await.unwrap().unwrap();
    assert_eq!(
        detected.detections,
        found_alone(&first).await.detections,
        "looking ahead changes nothing of the frame in hand"
    );
    let ahead = senses.ahead.as_ref().unwrap();
    assert!(ahead.is_of(&second) && !ahead.is_of(&first));

    senses.next_frame();
    let next = std::future::pending();
    let detected = senses.detect(&second, next).await.unwrap().unwrap();
    let alone = found_alone(&second).await;
    assert!(!alone.detections.is_empty());
    assert_eq!(detected.detections, alone.detections);
    // It did cost that time, only not now.
    assert!(senses.times.decode.unwrap() > Duration::ZERO);
    assert!(senses.times.letterbox.unwrap() > Duration::ZERO);
    assert!(senses.ahead.is_none());
}

#[tokio::test]
async fn a_picture_made_ready_whose_frame_never_comes_is_not_taken_for_another() {
    let [first, second, third] = pictures();
    let mut senses = senses().await;
    let next = std::future::ready((second, Need::Detections));
    senses.detect(&first, next).await.unwrap();
    senses.next_frame();
    let next = std::future::pending();
    let detected = senses.detect(&third, next).await.unwrap().unwrap();
    assert_eq!(detected.detections, found_alone(&third).await.detections);
}

#[tokio::test]
async fn a_broken_picture_made_ready_ahead_is_the_fault_of_its_own_frame() {
    let [first, second, _] = pictures();
    let broken = EncodedPicture {
        bytes: Bytes::copy_from_slice(&second.bytes[..second.bytes.len() / 2]),
        ..second.clone()
    };
    let mut senses = senses().await;
    let next = std::future::ready((broken.clone(), Need::Detections));
    assert!(senses.detect(&first, next).await.unwrap().is_some());
    senses.next_frame();
    let fault = senses.detect(&broken, std::future::pending()).await;
    assert!(fault.is_err());
    senses.next_frame();
    let detected = senses.detect(&second, std::future::pending()).await;
    assert!(detected.unwrap().is_some());
}

#[tokio::test]
async fn decoded_pictures_take_turns_in_the_same_buffers() {
    let [first, second, third] = pictures();
    let mut senses = senses().await;
    let mut buffers = std::collections::BTreeSet::new();
    for _ in 0..3 {
        for (picture, next) in [(&first, &second), (&second, &third), (&third, &first)] {
            let next = std::future::ready((next.clone(), Need::Detections));
            senses.detect(picture, next).await.unwrap();
            buffers.insert(senses.sight.picture.pixels.as_ptr() as usize);
            senses.next_frame();
        }
    }
    assert!(buffers.len() <= 2, "{} buffers", buffers.len());
}
