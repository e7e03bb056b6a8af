//! What calls the detector: the expected loss, or a schedule that knows nothing of the scene. All share
//! the same objects, so that what the trigger brings and what the object keeping brings can be told apart.

use super::settings::{Call, CallRule};
use crate::policy::{Knob, KnobError};

/// What calls the detector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trigger {
    /// The expected loss reaches λ.
    ExpectedLoss {
        /// The price of a call.
        lambda: f64,
    },
    /// The detector runs on one frame of `every`.
    FixedSkip {
        /// Frames from call to call.
        every: u32,
    },
    /// The detector runs as evenly as can be so that this share of the frames is skipped.
    Even {
        /// Share of frames to skip.
        skip_rate: f64,
    },
}

impl Trigger {
    /// λ of the expected loss.
    pub const LAMBDA: Knob = Knob {
        name: "lambda",
        meaning: "The detector is called when the boxes expected to be lost without it are worth this: \
                  higher saves more energy, lower is more accurate",
        minimum: 0.0,
        maximum: 100.0,
        default: 0.6,
    };

    /// The share of frames to skip under [`Trigger::Even`].
    pub const SKIP_RATE: Knob = Knob {
        name: "skip_rate",
        meaning: "Share of frames on which the detector is skipped, evenly spaced: higher saves more \
                  energy, lower is more accurate",
        minimum: 0.0,
        maximum: 0.95,
        default: 0.5,
    };

    /// Name of the policy with this trigger.
    pub const fn policy_name(&self) -> &'static str {
        match self {
            Self::ExpectedLoss { .. } => "expected-loss",
            Self::FixedSkip { .. } => "fixed-skip-in-tracker",
            Self::Even { .. } => "even-skip-in-tracker",
        }
    }

    /// The knob, if there is one.
    pub const fn knob(&self) -> Option<Knob> {
        match self {
            Self::ExpectedLoss { .. } => Some(Self::LAMBDA),
            Self::FixedSkip { .. } => None,
            Self::Even { .. } => Some(Self::SKIP_RATE),
        }
    }

    /// The knob's value.
    pub const fn knob_value(&self) -> Option<f64> {
        match *self {
            Self::ExpectedLoss { lambda } => Some(lambda),
            Self::FixedSkip { .. } => None,
            Self::Even { skip_rate } => Some(skip_rate),
        }
    }

    /// Turns the knob.
    ///
    /// # Errors
    /// [`KnobError`] if there is none or the value is out of its range.
    pub fn set_knob(&mut self, value: f64) -> Result<(), KnobError> {
        let policy = self.policy_name();
        match self {
            Self::ExpectedLoss { lambda } => *lambda = Self::LAMBDA.check(value)?,
            Self::FixedSkip { .. } => return Err(KnobError::Absent { policy }),
            Self::Even { skip_rate } => *skip_rate = Self::SKIP_RATE.check(value)?,
        }
        Ok(())
    }
}

/// The pause since the last call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pause {
    /// Frames since the last call, lost ones and the one in hand included.
    pub frames: u32,
    /// Frames answered without the detector since the last call.
    skipped: u32,
    /// Their summed losses.
    lost: f64,
    /// Calls that the even schedule owes.
    owed: f64,
}

impl Pause {
    /// Before the first call.
    pub const START: Self = Self {
        frames: 0,
        skipped: 0,
        lost: 0.0,
        owed: 0.0,
    };

    /// Another `step` frames began.
    pub fn advance(&mut self, trigger: &Trigger, step: u32) {
        self.frames = self.frames.saturating_add(step);
        if let Trigger::Even { skip_rate } = trigger {
            // A call cannot be made up for in frames that are gone.
            self.owed = (self.owed + (1.0 - skip_rate) * f64::from(step)).min(1.0);
        }
    }

    /// What is compared with λ on a frame of expected loss `loss`, with `crowd` boxes in view: see
    /// [`CallRule`].
    pub fn weigh(&self, rule: CallRule, loss: f64, crowd: f64) -> f64 {
        match rule {
            CallRule::Frame => loss / crowd.sqrt(),
            CallRule::Pause => (loss + (f64::from(self.skipped) * loss - self.lost)) / crowd,
        }
    }

    /// Whether the trigger calls the detector, for a loss of that `weight`.
    pub fn is_over(&self, trigger: &Trigger, settings: &Call, weight: f64) -> bool {
        match *trigger {
            Trigger::ExpectedLoss { lambda } => {
                weight >= lambda || self.frames >= settings.longest_pause
            }
            Trigger::FixedSkip { every } => self.frames >= every,
            // Sums of a rate such as 0.1 fall short of 1 by rounding.
            Trigger::Even { .. } => self.owed >= 1.0 - 1e-9,
        }
    }

    /// A frame was answered without the detector; without it `loss` was to be expected.
    pub fn skip(&mut self, loss: f64) {
        self.skipped = self.skipped.saturating_add(1);
        self.lost += loss;
    }

    /// The detector answered.
    pub fn end(&mut self) {
        *self = Self {
            owed: (self.owed - 1.0).max(0.0),
            ..Self::START
        };
    }
}
