//! The screen as one camera's loop asks it.

use super::{EmptyRun, ScreenConfig, ScreenHandle};
use crate::detector::CameraSlot;
use crate::picture::{InputFormat, Picture};
use albireo_core::geometry::PictureSize;
use std::sync::Arc;

/// The size to which a picture of `source` may be decoded, for a detector and a screen with these inputs: both
/// look at the same pixels.
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
    /// The model that all cameras share, if there is one.
    model: Option<ScreenHandle>,
    run: EmptyRun,
}

impl CameraScreen {
    /// A camera of which nothing is known yet; `model` is the one all cameras share, if there is one.
    pub fn new(config: &ScreenConfig, model: Option<ScreenHandle>) -> Self {
        Self {
            model,
            run: EmptyRun::new(config.longest_empty_run),
        }
    }

    /// Whether there is nothing to ask.
    pub const fn is_none(&self) -> bool {
        self.model.is_none()
    }

    /// The size to which a picture of `source` may be decoded, for this screen and a detector with that input.
    pub fn decoding_target(&self, detector: InputFormat, source: PictureSize) -> PictureSize {
        let screen = self.model.as_ref().map(ScreenHandle::input_format);
        decoding_target(detector, screen, source)
    }

    /// A new frame begins.
    pub fn next_frame(&mut self) {
        self.run.next_frame();
    }

    /// Whether nothing is in view in `picture`; `None` if the screen failed.
    pub async fn ask(&mut self, camera: CameraSlot, picture: &Arc<Picture>) -> Option<bool> {
        let model = self.model.as_ref()?;
        // The screen counts and logs its failures itself.
        let verdict = model.ask(camera, Arc::clone(picture)).await.ok()?;
        Some(self.run.limit(verdict.empty))
    }

    /// The detector ran on the frame.
    pub fn detector_ran(&mut self) {
        self.run.detector_ran();
    }

    /// Whether the detector runs on this frame because the screen answered "empty" too often in a row.
    pub const fn is_overruled(&self) -> bool {
        self.run.is_overruled()
    }
}
