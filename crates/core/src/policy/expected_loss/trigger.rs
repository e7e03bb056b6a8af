//! The triggers of a detector call: the expected loss, or a schedule that ignores the scene. All share the same
//! objects, so that the gains of trigger and tracking can be measured separately.

use crate::policy::{CallCause, ThresholdSpec};

/// The trigger of detector calls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trigger {
    /// The expected loss, weighed over the pause, reaches λ.
    ExpectedLoss {
        /// The price of a call.
        lambda: f64,
    },
    /// The detector runs on one frame of N, which may be fractional.
    FixedSkip {
        /// Mean number of frames from call to call.
        n: f64,
    },
    /// The detector runs as evenly as possible so that this share of frames is skipped.
    Even {
        /// Share of frames to skip.
        skip_rate: f64,
    },
}

impl Trigger {
    const LAMBDA: ThresholdSpec = ThresholdSpec {
        name: "lambda",
        meaning: "The detector is called when the boxes expected to be lost without it are worth this: \
                  higher saves more energy, lower is more accurate",
        minimum: 0.0,
        maximum: 100.0,
        default: 0.3,
        useful_minimum: 0.02,
        useful_maximum: 3.0,
    };

    const N: ThresholdSpec = ThresholdSpec {
        name: "n",
        meaning: "The detector runs on one frame in this many: higher saves more energy, lower is more \
                  accurate",
        minimum: 1.0,
        maximum: 20.0,
        default: 2.0,
        useful_minimum: 1.0,
        useful_maximum: 20.0,
    };

    const SKIP_RATE: ThresholdSpec = ThresholdSpec {
        name: "skip_rate",
        meaning: "Share of frames on which the detector is skipped, evenly spaced: higher saves more \
                  energy, lower is more accurate",
        minimum: 0.0,
        maximum: 0.95,
        default: 0.5,
        useful_minimum: 0.05,
        useful_maximum: 0.95,
    };

    /// Returns the trigger's threshold.
    pub const fn threshold_spec(&self) -> ThresholdSpec {
        match self {
            Self::ExpectedLoss { .. } => Self::LAMBDA,
            Self::FixedSkip { .. } => Self::N,
            Self::Even { .. } => Self::SKIP_RATE,
        }
    }

    /// Returns the value of the trigger's threshold.
    pub const fn value(&self) -> f64 {
        match *self {
            Self::ExpectedLoss { lambda: value }
            | Self::FixedSkip { n: value }
            | Self::Even { skip_rate: value } => value,
        }
    }

    /// Returns the same trigger with another value, which is not checked.
    pub(super) const fn with_value(self, value: f64) -> Self {
        match self {
            Self::ExpectedLoss { .. } => Self::ExpectedLoss { lambda: value },
            Self::FixedSkip { .. } => Self::FixedSkip { n: value },
            Self::Even { .. } => Self::Even { skip_rate: value },
        }
    }
}

/// The pause since the last call.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Pause {
    /// Frames since the last call, including lost ones and the current one.
    pub frames: u32,
    /// Frames answered without the detector since the last call.
    skipped: u32,
    /// Their summed losses.
    lost: f64,
    /// Calls due by a schedule.
    owed: f64,
}

impl Pause {
    /// Advances by `step` frames.
    pub(crate) fn advance(&mut self, trigger: &Trigger, step: u32) {
        self.frames = self.frames.saturating_add(step);
        let rate = match *trigger {
            Trigger::ExpectedLoss { .. } => return,
            Trigger::FixedSkip { n } => 1.0 / n,
            Trigger::Even { skip_rate } => 1.0 - skip_rate,
        };
        self.owed += rate * f64::from(step);
        // Only one call missed in a gap is made up for, because the frames are gone.
        if self.owed >= 2.0 {
            self.owed = 1.0 + self.owed.fract();
        }
    }

    /// Returns the weight to compare with λ on a frame of expected loss `loss`, with `crowd` boxes in view:
    /// `(L + Σ (L − L_t)) / N̄` over the frames t skipped since the last call.
    pub(crate) fn weigh(&self, loss: f64, crowd: f64) -> f64 {
        (loss + (f64::from(self.skipped) * loss - self.lost)) / crowd
    }

    /// Returns the reason for a detector call at this `weight`; `None` without a call.
    pub(crate) fn call(
        &self,
        trigger: &Trigger,
        longest_pause: u32,
        weight: f64,
    ) -> Option<CallCause> {
        match *trigger {
            Trigger::ExpectedLoss { lambda } if weight >= lambda => Some(CallCause::ExpectedLoss),
            Trigger::ExpectedLoss { .. } => {
                let capped = self.frames >= longest_pause;
                capped.then_some(CallCause::PeriodicCap)
            }
            Trigger::FixedSkip { .. } | Trigger::Even { .. } => {
                // Sums of a rate such as 0.1 fall short of 1 by rounding.
                let is_due = self.owed >= 1.0 - 1e-9;
                is_due.then_some(CallCause::Schedule)
            }
        }
    }

    /// Counts a frame answered without the detector, with an expected loss of `loss`.
    pub(crate) fn skip(&mut self, loss: f64) {
        self.skipped = self.skipped.saturating_add(1);
        self.lost += loss;
    }

    /// Ends the pause after a detector answer.
    pub(crate) fn end(&mut self) {
        *self = Self {
            owed: (self.owed - 1.0).max(0.0),
            ..Self::default()
        };
    }
}
