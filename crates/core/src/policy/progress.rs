//! The progress of the current frame through a policy: what it waits for, and what its outcome will say.

use super::{CallCause, Evidence, FrameState, Need, Outcome};

/// The progress of the current frame, from [`begin`](super::Policy::begin) to [`finish`](super::Policy::finish).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Progress {
    /// The evidence that the frame waits for.
    pub need: Need,
    /// True if the screen reported "not empty".
    pub screened: bool,
    /// The frame's state, as far as the evidence shows it.
    pub state: FrameState,
    /// The reason for the detector call.
    pub cause: Option<CallCause>,
    /// Largest uncertainty of the active objects.
    pub tau_max: Option<f64>,
    /// Number of active objects.
    pub active: usize,
}

impl Progress {
    /// Waits for `need`.
    pub(crate) fn ask(&mut self, need: Need) -> Need {
        self.need = need;
        need
    }

    /// Calls the detector if there is a `cause`; otherwise nothing more is needed.
    pub(crate) fn call(&mut self, cause: Option<CallCause>) -> Need {
        self.cause = cause;
        self.ask(match cause {
            Some(_) => Need::Detections,
            None => Need::Nothing,
        })
    }

    /// Receives the screen's verdict: "empty" needs nothing more, "not empty" and no verdict need `next`.
    pub(crate) fn take_verdict(&mut self, evidence: Evidence<'_>, next: Need) -> Need {
        match evidence {
            Evidence::Screen { empty: true } => {
                self.state = FrameState::E;
                return self.call(None);
            }
            Evidence::Screen { empty: false } => {
                self.screened = true;
                self.cause = Some(CallCause::Screen);
            }
            _ => {}
        }
        self.ask(next)
    }

    /// Ends with the detector's answer.
    pub(crate) fn detected(&mut self) -> Need {
        self.end(FrameState::I)
    }

    /// Ends with the detector's answer, which missed an object that is kept by its prediction.
    pub(crate) fn detected_with_rescue(&mut self) -> Need {
        self.end(FrameState::AI)
    }

    /// Ends in the state `unscreened`, or in `E+I` if the screen reported "not empty".
    fn end(&mut self, unscreened: FrameState) -> Need {
        self.state = if self.screened {
            FrameState::EI
        } else {
            unscreened
        };
        self.ask(Need::Nothing)
    }

    /// Overwrites `outcome` with all but the boxes, of which there are none yet. A frame that called the detector in vain
    /// is degraded.
    pub(crate) fn finish(&self, outcome: &mut Outcome) {
        outcome.state = self.state;
        outcome.degraded = self.cause.is_some() && self.state.is_skipped();
        outcome.cause = self.cause;
        outcome.tau_max = self.tau_max;
        outcome.active = self.active;
        outcome.boxes.clear();
    }
}
