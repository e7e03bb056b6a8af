//! What counts of a screen's verdict: what the agnostic screen has learnt of one camera, and the limit on how long
//! any screen is believed. It asks no model, so that the node and the evaluation share it.

use super::agnostic::{AgnosticScreen, Thumbnail};
use super::camera::ScreenCounts;
use super::{EmptyRun, ScreenConfig, ScreenKind};

/// What one camera's screen remembers from frame to frame, whichever kind it is.
#[derive(Clone, Debug)]
pub struct ScreenJudge {
    agnostic: Option<Box<AgnosticScreen>>,
    run: EmptyRun,
}

impl ScreenJudge {
    /// A camera of which nothing is known yet, under the screen that `config` names. `seed` decides which pictures
    /// the agnostic screen leaves to the detector by chance.
    pub fn new(config: &ScreenConfig, seed: u64) -> Self {
        let agnostic = (config.kind() == ScreenKind::Agnostic)
            .then(|| Box::new(AgnosticScreen::new(&config.agnostic, seed)));
        Self {
            agnostic,
            run: EmptyRun::new(config.longest_empty_run),
        }
    }

    /// Whether the screen is the agnostic one, which is asked here and not elsewhere.
    pub const fn is_agnostic(&self) -> bool {
        self.agnostic.is_some()
    }

    /// A new frame begins.
    pub fn next_frame(&mut self) {
        if let Some(screen) = &mut self.agnostic {
            screen.next_frame();
        }
    }

    /// What counts of a model's verdict `empty`.
    pub fn model_said(&mut self, empty: bool) -> bool {
        self.run.judge(empty)
    }

    /// The agnostic screen's verdict on a picture, as it counts; `None` without such a screen.
    pub fn look_at(&mut self, picture: Thumbnail) -> Option<bool> {
        let empty = self.agnostic.as_mut()?.empty(picture);
        Some(self.run.judge(empty))
    }

    /// The detector looked at the frame in hand and did or did not find something; `picture` is asked for if the
    /// screen has not seen it.
    pub fn detected(&mut self, found_something: bool, picture: impl FnOnce() -> Option<Thumbnail>) {
        self.run.looked();
        if let Some(screen) = &mut self.agnostic {
            screen.detected(found_something, picture);
        }
    }

    /// What has been counted so far.
    pub fn counts(&self) -> ScreenCounts {
        let agnostic = self
            .agnostic
            .as_ref()
            .map(|screen| screen.counters())
            .unwrap_or_default();
        ScreenCounts {
            forced: self.run.forced(),
            audited: agnostic.audited,
            false_empty: agnostic.false_empty,
        }
    }
}
