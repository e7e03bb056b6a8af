//! What counts of a screen's verdict: what the agnostic screen has learnt of one camera, and the limit on how long
//! any screen is believed. It asks no model, so that the node and the evaluation share it.

use super::agnostic::{AgnosticScreen, Thumbnail};
use super::camera::ScreenCounts;
use super::{EmptyRun, ScreenConfig, ScreenKind};
use albireo_core::policy::CallCause;

/// What one camera's screen remembers from frame to frame, whichever kind it is.
#[derive(Clone, Debug)]
pub struct ScreenJudge {
    agnostic: Option<Box<AgnosticScreen>>,
    run: EmptyRun,
    /// Why the detector looks at the frame in hand although the screen would say "empty".
    overruled: Option<CallCause>,
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
            overruled: None,
        }
    }

    /// Whether the screen is the agnostic one, which is asked here and not elsewhere.
    pub const fn is_agnostic(&self) -> bool {
        self.agnostic.is_some()
    }

    /// A new frame begins.
    pub fn next_frame(&mut self) {
        self.overruled = None;
        if let Some(screen) = &mut self.agnostic {
            screen.next_frame();
        }
    }

    /// What counts of a model's verdict `empty`.
    pub fn model_said(&mut self, empty: bool) -> bool {
        self.judge(empty)
    }

    /// The agnostic screen's verdict on a picture, as it counts; `None` without such a screen.
    pub fn look_at(&mut self, picture: Thumbnail) -> Option<bool> {
        let screen = self.agnostic.as_mut()?;
        let empty = screen.empty(picture);
        if screen.audits() {
            self.overruled = Some(CallCause::Audit);
        }
        Some(self.judge(empty))
    }

    fn judge(&mut self, empty: bool) -> bool {
        let counts = self.run.judge(empty);
        if empty && !counts {
            self.overruled = Some(CallCause::EmptyLimit);
        }
        counts
    }

    /// Why the detector looks at the frame in hand although the screen would say "empty"; `None` where it does not, or
    /// the screen saw something.
    pub fn overruled(&self) -> Option<CallCause> {
        self.overruled
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
