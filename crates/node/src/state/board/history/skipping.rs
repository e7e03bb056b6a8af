//! Estimates from recorded uncertainties which of the last frames another threshold would have skipped.
//!
//! Replays the frames under the other value. Where the detector would have rested longer or shorter than it did, the
//! recorded uncertainty is scaled by its growth with the time since a call ([`Growth`]). Calls for reasons other than
//! uncertainty (no objects, the screen) are repeated, and at the policy's longest pause there is a call. It remains an
//! estimate: other frames would have been matched, so other objects might be tracked.

use super::PastFrame;
use super::growth::{Aged, Growth, aged};
use albireo_core::policy::CallCause;
use serde::Serialize;
use utoipa::ToSchema;

/// The estimate for one value.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct ValueEstimate {
    /// The value.
    value: f64,
    /// Frames without the detector.
    pub skipped: usize,
    /// Share of the frames.
    pub skip_rate: f64,
}

/// Estimates of the frames that other thresholds would have skipped.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct SkipEstimate {
    /// The number of frames.
    frames: usize,
    /// Time they took, seconds.
    duration_s: f64,
    /// Frames that were actually answered without the detector.
    pub skipped: usize,
    /// Their share of the frames.
    skip_rate: f64,
    /// The estimate for each value, in the requested order.
    pub values: Vec<ValueEstimate>,
}

impl SkipEstimate {
    /// Estimates these values from recorded frames, oldest first, of a policy with this longest pause; `None` without a
    /// frame after a detector call.
    pub(crate) fn of(
        frames: &[PastFrame],
        longest_pause: Option<u32>,
        values: &[f64],
    ) -> Option<Self> {
        let frames = aged(frames);
        let growth = Growth::of(&frames);
        let longest_pause = longest_pause.unwrap_or(u32::MAX);
        let first = frames.first()?.frame;
        let last = frames.last()?.frame;
        let share = |skipped: usize| skipped as f64 / frames.len() as f64;
        let is_skipped = |aged: &&Aged| aged.frame.state.is_skipped() && !aged.frame.degraded;
        let skipped = frames.iter().filter(is_skipped).count();
        let values = values.iter().map(|value| {
            let skipped = skipped_at(*value, &frames, &growth, longest_pause);
            ValueEstimate {
                value: *value,
                skipped,
                skip_rate: share(skipped),
            }
        });
        Some(Self {
            frames: frames.len(),
            duration_s: (last.at_ms - first.at_ms) as f64 / 1e3,
            skipped,
            skip_rate: share(skipped),
            values: values.collect(),
        })
    }
}

/// The number of frames that would have been answered without the detector under the threshold `u`.
fn skipped_at(u: f64, frames: &[Aged], growth: &Growth, longest_pause: u32) -> usize {
    let limit = u.ln();
    let mut pause: u32 = 0;
    let mut skipped = 0;
    for aged in frames {
        pause = pause.saturating_add(aged.step);
        let calls = match (aged.frame.cause, aged.frame.tau_max) {
            // Independent of the threshold.
            (Some(cause), _) if !depends_on_threshold(cause) => true,
            (_, None) => false,
            (_, Some(tau)) => {
                let grown = growth.log(pause) - growth.log(aged.age);
                pause >= longest_pause || f64::from(tau).ln() + grown >= limit
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

/// True if another threshold could have moved a call of this cause: one for the tracked objects, or at the longest pause
/// since the last.
fn depends_on_threshold(cause: CallCause) -> bool {
    matches!(
        cause,
        CallCause::Uncertain | CallCause::NewObject | CallCause::ObjectCap | CallCause::PeriodicCap
    )
}
