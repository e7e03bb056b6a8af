//! What another threshold would have skipped over the last frames: an estimate from the recorded uncertainties.
//!
//! The frames are walked through once more under the other value. Where the detector would have rested for longer or
//! shorter than it did, the recorded uncertainty is scaled by how it grew with the time since a call ([`Growth`]). What
//! called the detector for another reason than uncertainty (no objects, the screen) calls it again, and so does the longest
//! pause that the policy allows. It stays an estimate: other frames would have been matched, so other objects might be
//! followed.

use super::PastFrame;
use super::growth::{Aged, Growth, aged};
use albireo_core::policy::CallCause;

/// What the recorded frames say of other thresholds.
#[derive(Clone, Debug)]
pub(crate) struct SkipEstimate {
    frames: Vec<Aged>,
    growth: Growth,
    longest_pause: u32,
}

/// What one value would have done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Estimate {
    /// Frames looked at.
    pub frames: usize,
    /// Of these, without the detector.
    pub skipped: usize,
}

impl Estimate {
    /// Share of frames without the detector; 0 without frames.
    pub(crate) fn skip_rate(self) -> f64 {
        match self.frames {
            0 => 0.0,
            frames => self.skipped as f64 / frames as f64,
        }
    }
}

impl SkipEstimate {
    /// From recorded frames, oldest first, of a policy with this longest skip run.
    pub(crate) fn new(frames: &[PastFrame], longest_pause: Option<u32>) -> Self {
        let frames = aged(frames);
        Self {
            growth: Growth::of(&frames),
            frames,
            longest_pause: longest_pause.unwrap_or(u32::MAX),
        }
    }

    /// What really happened over the frames that are looked at.
    pub(crate) fn really(&self) -> Estimate {
        let skipped = self.frames.iter().filter(|aged| {
            let frame = &aged.frame;
            frame.state.is_skipped() && !frame.degraded
        });
        Estimate {
            frames: self.frames.len(),
            skipped: skipped.count(),
        }
    }

    /// When the first of these frames was answered and when the last, milliseconds since the node's start.
    pub(crate) fn span_ms(&self) -> Option<(u64, u64)> {
        let (first, last) = self.frames.first().zip(self.frames.last())?;
        Some((first.frame.at_ms, last.frame.at_ms))
    }

    /// What the threshold `u` would have done.
    pub(crate) fn at(&self, u: f64) -> Estimate {
        let limit = u.ln();
        let mut pause: u32 = 0;
        let mut skipped = 0;
        for aged in &self.frames {
            pause = pause.saturating_add(aged.step);
            let calls = match (aged.frame.cause, aged.frame.tau_max()) {
                // Nothing that a threshold has a say in.
                (Some(cause), _) if !of_objects(cause) => true,
                (_, None) => false,
                (_, Some(tau)) => {
                    let grown = self.growth.log(pause) - self.growth.log(aged.age);
                    pause >= self.longest_pause || f64::from(tau).ln() + grown >= limit
                }
            };
            if calls {
                pause = 0;
            } else {
                skipped += 1;
            }
        }
        Estimate {
            frames: self.frames.len(),
            skipped,
        }
    }
}

/// Whether the detector was called because of the objects that are followed.
fn of_objects(cause: CallCause) -> bool {
    matches!(
        cause,
        CallCause::Uncertain | CallCause::NewObject | CallCause::ObjectCap | CallCause::PeriodicCap
    )
}
