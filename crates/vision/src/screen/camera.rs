//! The screen as one camera's loop asks it, whichever kind is configured.

use super::agnostic::Thumbnail;
use super::{ScreenConfig, ScreenHandle, ScreenJudge, ScreenKind};
use crate::detector::CameraSlot;
use crate::picture::{InputFormat, Picture};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::CallCause;
use std::sync::Arc;

/// What one camera's screen has counted since the node started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ScreenCounts {
    /// Frames on which the detector looked because too many in a row had been called empty.
    pub forced: u64,
    /// Frames that the agnostic screen would have called empty and the detector looked at.
    pub audited: u64,
    /// Those of them in which the detector found something.
    pub false_empty: u64,
}

/// The size to which a picture of `source` may be decoded, for a detector and a screen with these inputs: both
/// look at the same pixels. What the agnostic screen looks at is never missing, so that pictures are the same
/// whichever screen is asked, in the node and in the evaluation.
pub fn decoding_target(
    detector: InputFormat,
    screen: Option<InputFormat>,
    source: PictureSize,
) -> PictureSize {
    let fitted = [Some(detector), screen].into_iter().flatten();
    fitted
        .map(|format| format.fitted(source))
        .fold(Thumbnail::TARGET, |most, size| {
            PictureSize::new(most.width.max(size.width), most.height.max(size.height))
        })
}

/// One camera's screen.
pub struct CameraScreen {
    /// The model that all cameras share, where that is the kind.
    model: Option<ScreenHandle>,
    judge: ScreenJudge,
}

impl CameraScreen {
    /// The screen that `config` names; `model` is the one all cameras share, if there is one.
    pub fn new(config: &ScreenConfig, model: Option<ScreenHandle>, camera: CameraSlot) -> Self {
        Self {
            model: model.filter(|_| config.kind() == ScreenKind::Model),
            judge: ScreenJudge::new(config, camera.0 as u64),
        }
    }

    /// Whether there is nothing to ask.
    pub const fn is_none(&self) -> bool {
        self.model.is_none() && !self.judge.is_agnostic()
    }

    /// Whether it looks at a picture after the detector has.
    pub const fn keeps_pictures(&self) -> bool {
        self.judge.is_agnostic()
    }

    /// The size to which a picture of `source` may be decoded, for this screen and a detector with that input.
    pub fn decoding_target(&self, detector: InputFormat, source: PictureSize) -> PictureSize {
        let screen = self.model.as_ref().map(ScreenHandle::input_format);
        decoding_target(detector, screen, source)
    }

    /// A new frame begins.
    pub fn next_frame(&mut self) {
        self.judge.next_frame();
    }

    /// Whether nothing is in view in `picture`; `None` when it cannot be said.
    pub async fn ask(&mut self, camera: CameraSlot, picture: &Arc<Picture>) -> Option<bool> {
        match &self.model {
            Some(model) => {
                // The screen counts and logs its failures itself.
                let verdict = model.ask(camera, Arc::clone(picture)).await.ok()?;
                Some(self.judge.model_said(verdict.empty))
            }
            None => self.judge.look_at(Thumbnail::of(picture)?),
        }
    }

    /// The detector looked at `picture` and did or did not find something.
    pub fn detected(&mut self, picture: Option<&Picture>, found_something: bool) {
        self.judge
            .detected(found_something, || Thumbnail::of(picture?));
    }

    /// Why the detector looks at the frame in hand although the screen would say "empty".
    pub fn overruled(&self) -> Option<CallCause> {
        self.judge.overruled()
    }

    /// What it has counted.
    pub fn counts(&self) -> ScreenCounts {
        self.judge.counts()
    }
}
