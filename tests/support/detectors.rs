//! The tiny models of tests/fixtures/models, and pictures for them.

use albireo_core::geometry::PictureSize;
use albireo_vision::detector::DetectorConfig;
use albireo_vision::picture::Picture;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Twice the size of the models' input.
pub(crate) const PICTURE: PictureSize = PictureSize::new(128, 64);

/// A model's file.
pub(crate) fn model(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/models")
        .join(name)
}

/// A detector with that model and nothing else configured.
pub(crate) fn config(name: &str) -> DetectorConfig {
    DetectorConfig {
        model: model(name),
        ..DetectorConfig::default()
    }
}

/// A picture of one colour.
pub(crate) fn one_colour(color: [u8; 3]) -> Arc<Picture> {
    let mut picture = Picture::black(PICTURE);
    for pixel in picture.pixels.chunks_exact_mut(3) {
        pixel.copy_from_slice(&color);
    }
    Arc::new(picture)
}
