//! The screen as one camera's loop asks it: whichever kind is configured, with what it has learnt of this
//! camera, and with a limit on how long it may be believed.

use super::agnostic::{AgnosticScreen, Thumbnail};
use super::{EmptyRun, ScreenConfig, ScreenHandle, ScreenKind};
use crate::detector::CameraSlot;
use crate::frame::{InputFormat, Picture};
use albireo_core::geometry::PictureSize;
use std::sync::Arc;

enum Kind {
    None,
    Model(ScreenHandle),
    Agnostic(Box<AgnosticScreen>),
}

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
pub(crate) struct CameraScreen {
    kind: Kind,
    run: EmptyRun,
}

impl CameraScreen {
    /// The screen that `config` names; `model` is the one all cameras share, if there is one.
    pub(crate) fn new(
        config: &ScreenConfig,
        model: Option<ScreenHandle>,
        camera: CameraSlot,
    ) -> Self {
        let kind = match (config.kind(), model) {
            (ScreenKind::Agnostic, _) => {
                let seed = camera.0 as u64;
                Kind::Agnostic(Box::new(AgnosticScreen::new(&config.agnostic, seed)))
            }
            (ScreenKind::Model, Some(model)) => Kind::Model(model),
            (ScreenKind::Model | ScreenKind::None, _) => Kind::None,
        };
        Self {
            kind,
            run: EmptyRun::new(config.longest_empty_run),
        }
    }

    /// Whether there is nothing to ask.
    pub(crate) const fn is_none(&self) -> bool {
        matches!(self.kind, Kind::None)
    }

    /// The size to which a picture of `source` may be decoded, for this screen and a detector with that input.
    pub(crate) fn decoding_target(
        &self,
        detector: InputFormat,
        source: PictureSize,
    ) -> PictureSize {
        let screen = match &self.kind {
            Kind::Model(model) => Some(model.input_format()),
            Kind::None | Kind::Agnostic(_) => None,
        };
        decoding_target(detector, screen, source)
    }

    /// A new frame begins.
    pub(crate) fn next_frame(&mut self) {
        if let Kind::Agnostic(screen) = &mut self.kind {
            screen.next_frame();
        }
    }

    /// Whether nothing is in view in `picture`; `None` when it cannot be said.
    pub(crate) async fn ask(&mut self, camera: CameraSlot, picture: &Arc<Picture>) -> Option<bool> {
        let empty = match &mut self.kind {
            Kind::None => None,
            Kind::Model(model) => {
                let verdict = model.ask(camera, Arc::clone(picture)).await;
                // The screen counts and logs its failures itself.
                verdict.ok().map(|verdict| verdict.empty)
            }
            Kind::Agnostic(screen) => {
                Thumbnail::of(picture).map(|thumbnail| screen.empty(thumbnail))
            }
        }?;
        Some(self.run.judge(empty))
    }

    /// The detector looked at `picture` and did or did not find something.
    pub(crate) fn detected(&mut self, picture: &Picture, found_something: bool) {
        self.run.looked();
        if let Kind::Agnostic(screen) = &mut self.kind {
            screen.detected(found_something, || Thumbnail::of(picture));
        }
    }

    /// What it has counted.
    pub(crate) fn counts(&self) -> ScreenCounts {
        let agnostic = match &self.kind {
            Kind::Agnostic(screen) => screen.counters(),
            Kind::None | Kind::Model(_) => Default::default(),
        };
        ScreenCounts {
            forced: self.run.forced(),
            audited: agnostic.audited,
            false_empty: agnostic.false_empty,
        }
    }
}
