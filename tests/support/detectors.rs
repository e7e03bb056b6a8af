//! The tiny models of tests/fixtures/models, and pictures for them.

use albireo_core::detection::Detection;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::detector::{CameraSlot, DetectorConfig, DetectorHandle};
use albireo_vision::picture::{EncodedPicture, FrameLimits, Picture, PixelLayout, decode};
use std::path::PathBuf;
use std::sync::Arc;

pub(crate) const CAMERA: CameraSlot = CameraSlot(0);

/// Twice the size of the models' input.
pub(crate) const PICTURE: PictureSize = PictureSize::new(128, 64);

pub(crate) fn model(name: &str) -> PathBuf {
    super::project("tests/fixtures/models").join(name)
}

pub(crate) fn config(name: &str) -> DetectorConfig {
    DetectorConfig {
        model: model(name),
        ..DetectorConfig::default()
    }
}

pub(crate) fn changed(name: &str, change: impl FnOnce(&mut DetectorConfig)) -> DetectorConfig {
    let mut config = config(name);
    change(&mut config);
    config
}

pub(crate) async fn started(config: &DetectorConfig) -> DetectorHandle {
    let started = DetectorHandle::start(config).await;
    started.unwrap_or_else(|error| panic!("{config:?}: {error}"))
}

pub(crate) async fn refusal(config: &DetectorConfig) -> String {
    let started = DetectorHandle::start(config).await;
    started
        .err()
        .map(|error| error.to_string())
        .unwrap_or_else(|| panic!("{config:?} was accepted"))
}

pub(crate) async fn detected(detector: &DetectorHandle, color: [u8; 3]) -> Vec<Detection> {
    let detected = detector.detect(CAMERA, one_colour(color)).await;
    detected.unwrap().output.detections
}

/// Asserts that the only detection is the fixtures' box in a picture of size [`PICTURE`].
#[track_caller]
pub(crate) fn assert_the_box(found: &[Detection], class: u16, confidence: f64) {
    let [detection] = found else {
        panic!("not one box: {found:?}");
    };
    assert_eq!(detection.class.0, class);
    let off = (detection.confidence - confidence).abs();
    assert!(off < 2e-3, "{detection:?}");
    let Corners { x1, y1, x2, y2 } = detection.bounding_box.pixel_corners(PICTURE);
    for (found, expected) in [x1, y1, x2, y2].into_iter().zip([16.0, 8.0, 80.0, 40.0]) {
        assert!((found - expected).abs() < 0.05, "{detection:?}");
    }
}

pub(crate) fn decoded(picture: &EncodedPicture) -> Picture {
    let mut into = Picture::default();
    let limits = FrameLimits::default();
    let layout = PixelLayout::Rgb8;
    decode(picture, &limits, layout, None, &mut into).unwrap();
    into
}

pub(crate) fn one_colour(color: [u8; 3]) -> Arc<Picture> {
    let mut picture = Picture::black(PICTURE);
    for pixel in picture.pixels.chunks_exact_mut(3) {
        pixel.copy_from_slice(&color);
    }
    Arc::new(picture)
}
