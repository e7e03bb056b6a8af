//! One camera's view of the screen.

use super::{EmptyRun, ScreenConfig, ScreenHandle};
use crate::detector::CameraSlot;
use crate::picture::{InputFormat, Picture};
use albireo_core::geometry::PictureSize;
use std::sync::Arc;

/// The size to which a picture of `source` may be decoded for a detector and a screen with these inputs: both look at
/// the same pixels.
pub fn decoding_target(
    detector: InputFormat,
    screen: Option<InputFormat>,
    source: PictureSize,
) -> PictureSize {
    let of_detector = detector.fitted(source);
    let of_screen = screen.map_or(of_detector, |screen| screen.fitted(source));
    PictureSize::new(
        of_detector.width.max(of_screen.width),
        of_detector.height.max(of_screen.height),
    )
}

/// One camera's screen.
pub struct CameraScreen {
    /// The model shared by all cameras, if there is one.
    model: Option<ScreenHandle>,
    run: EmptyRun,
}

impl CameraScreen {
    /// Creates the screen of a new camera; `model` is the one shared by all cameras, if there is one.
    pub fn new(config: &ScreenConfig, model: Option<ScreenHandle>) -> Self {
        Self {
            model,
            run: EmptyRun::new(config.longest_empty_run),
        }
    }

    /// True if there is no model.
    pub const fn is_none(&self) -> bool {
        self.model.is_none()
    }

    /// The size to which a picture of `source` may be decoded for this screen and a detector with this input.
    pub fn decoding_target(&self, detector: InputFormat, source: PictureSize) -> PictureSize {
        let screen = self.model.as_ref().map(ScreenHandle::input_format);
        decoding_target(detector, screen, source)
    }

    /// Begins a new frame.
    pub fn next_frame(&mut self) {
        self.run.next_frame();
    }

    /// Returns true if nothing is in view in `picture`; `None` if the screen failed or there is none.
    pub async fn ask(&mut self, camera: CameraSlot, picture: &Arc<Picture>) -> Option<bool> {
        let model = self.model.as_ref()?;
        // The screen counts and logs its failures itself.
        let verdict = model.ask(camera, Arc::clone(picture)).await.ok()?;
        Some(self.run.limit(verdict.empty))
    }

    /// Records that the detector ran on the frame.
    pub fn detector_ran(&mut self) {
        self.run.detector_ran();
    }

    /// True if the detector runs on this frame because the screen answered "empty" too often in a row.
    pub const fn is_overruled(&self) -> bool {
        self.run.is_overruled()
    }
}
