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

    /// Frames looked at.
    pub(crate) fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Share of the frames, 0 to 1; 0 without frames.
    pub(crate) fn share(&self, frames: usize) -> f64 {
        frames as f64 / self.frames.len().max(1) as f64
    }

    /// Frames that really were answered without the detector.
    pub(crate) fn skipped(&self) -> usize {
        let frames = self.frames.iter().map(|aged| &aged.frame);
        frames
            .filter(|frame| frame.state.is_skipped() && !frame.degraded)
            .count()
    }

    /// From the answer of the first of these frames to that of the last, seconds; `None` without frames.
    pub(crate) fn duration_s(&self) -> Option<f64> {
        let (first, last) = self.frames.first().zip(self.frames.last())?;
        Some((last.frame.at_ms - first.frame.at_ms) as f64 / 1e3)
    }

    /// Frames that would have been answered without the detector under the threshold `u`.
    pub(crate) fn skipped_at(&self, u: f64) -> usize {
        let limit = u.ln();
        let mut pause: u32 = 0;
        let mut skipped = 0;
        for aged in &self.frames {
            pause = pause.saturating_add(aged.step);
            let calls = match (aged.frame.cause, aged.frame.tau_max) {
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
        skipped
    }
}

/// Whether the detector was called because of the objects that are followed.
fn of_objects(cause: CallCause) -> bool {
    matches!(
        cause,
        CallCause::Uncertain | CallCause::NewObject | CallCause::ObjectCap | CallCause::PeriodicCap
    )
}
