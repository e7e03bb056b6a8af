//! Targets instead of a fixed threshold: a slow controller moves a policy's knob until the measured value reaches the target.
//!
//! [`TargetController::step`] takes the measurements once per second and returns the knob's value and the reason. It is
//! an integral controller in the logarithm of the knob. The knob's value *is* the integral and never leaves its range, so
//! nothing winds up while a target cannot be met, and the controller reacts at once when it can.
//!
//! The load targets ([`Target::SkipRate`], [`Target::Watts`]) settle within a minute. [`Target::Recall`] goes by the audit ([`crate::audit`]) and moves only when enough boxes have been
//! compared since it moved last.

mod load;
mod recall;
#[cfg(test)]
mod tests;

use crate::audit::AuditSums;
use crate::policy::{Knob, short};
use load::LoadControl;
use recall::RecallControl;
use serde::{Deserialize, Serialize};

/// What is to be held. As JSON one field: `{"skip_rate": 0.5}`.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// Recall against the detector: the lower end of its interval is held at this.
    Recall(f64),
    /// Share of frames that skip the detector.
    SkipRate(f64),
    /// Mean power of the node, watts.
    Watts(f64),
}

impl Target {
    /// The names of all.
    pub const NAMES: [&'static str; 3] = ["recall", "skip_rate", "watts"];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Recall(_) => "recall",
            Self::SkipRate(_) => "skip_rate",
            Self::Watts(_) => "watts",
        }
    }

    /// Its value.
    pub const fn value(self) -> f64 {
        match self {
            Self::Recall(value) | Self::SkipRate(value) | Self::Watts(value) => value,
        }
    }

    /// The target of that name and value; `None` where there is none of that name.
    pub fn named(name: &str, value: f64) -> Option<Self> {
        let all = [
            Self::Recall(value),
            Self::SkipRate(value),
            Self::Watts(value),
        ];
        all.into_iter().find(|target| target.name() == name)
    }

    /// Itself, if its value is one that could be held.
    ///
    /// # Errors
    /// [`TargetError::Value`] otherwise, NaN and infinities included.
    pub fn check(self) -> Result<Self, TargetError> {
        let (least, most) = match self {
            Self::Recall(_) => (0.1, 0.999),
            Self::SkipRate(_) => (0.01, 0.99),
            Self::Watts(_) => (0.01, 100_000.0),
        };
        let value = self.value();
        // NaN is in no range.
        if (least..=most).contains(&value) {
            Ok(self)
        } else {
            Err(TargetError::Value {
                name: self.name(),
                least,
                most,
                value,
            })
        }
    }
}

impl std::fmt::Display for Target {
    /// `skip_rate 0.5`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.name(), short(self.value()))
    }
}

/// Why a target cannot be held.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TargetError {
    /// Its value makes no sense.
    #[error("`{name}` must be a number from {} to {}, not {value}", short(*.least), short(*.most))]
    Value {
        /// The target's name.
        name: &'static str,
        /// Least value.
        least: f64,
        /// Largest value.
        most: f64,
        /// What was given.
        value: f64,
    },
    /// The policy has no knob that a controller could turn.
    #[error(
        "a target moves `u` or `lambda`, and policy `{policy}` has {}",
        knob.map_or_else(|| "nothing to turn".to_owned(), |knob| format!("`{knob}`"))
    )]
    Policy {
        /// The policy.
        policy: String,
        /// Its knob.
        knob: Option<&'static str>,
    },
    /// The range is none within the knob's.
    #[error("the range of `{name}` must lie within {} to {}, and its ends apart", short(*.least), short(*.most))]
    Range {
        /// The knob's name.
        name: &'static str,
        /// The knob's smallest value.
        least: f64,
        /// The knob's largest value.
        most: f64,
    },
}

/// Between which values a controller moves a knob.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KnobRange {
    /// Smallest value: the most accurate one.
    pub least: f64,
    /// Largest value: what accuracy still allows.
    pub most: f64,
}

impl KnobRange {
    /// The range in which a controller moves `knob`: between the ends given, each by default the end of what costs little
    /// accuracy: `u` 1.5e-4 to 2e-3, `lambda` 0.05 to 1.2 (on the recorded sequences `expected-loss` loses 2.4 points of
    /// AP@50 to a detector on every frame there, and `albireo` 3.3 at 1e-3).
    ///
    /// # Errors
    /// [`TargetError`] when the knob is none that a controller turns, or the range does not lie within the knob's.
    pub fn of(
        policy: &str,
        knob: Option<&Knob>,
        least: Option<f64>,
        most: Option<f64>,
    ) -> Result<Self, TargetError> {
        let (knob, safe) = match knob {
            Some(knob) if knob.name == "u" => (knob, (1.5e-4, 2e-3)),
            Some(knob) if knob.name == "lambda" => (knob, (0.05, 1.2)),
            other => {
                return Err(TargetError::Policy {
                    policy: policy.to_owned(),
                    knob: other.map(|knob| knob.name),
                });
            }
        };
        let range = Self {
            least: least.unwrap_or(safe.0),
            most: most.unwrap_or(safe.1),
        };
        let inside = knob.check(range.least).is_ok() && knob.check(range.most).is_ok();
        if inside && range.least > 0.0 && range.least < range.most {
            Ok(range)
        } else {
            Err(TargetError::Range {
                name: knob.name,
                least: knob.minimum,
                most: knob.maximum,
            })
        }
    }

    fn logarithms(self) -> (f64, f64) {
        (self.least.ln(), self.most.ln())
    }
}

/// What was measured since the step before.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// How long that was, seconds.
    pub seconds: f64,
    /// Frames.
    pub frames: u64,
    /// Those of them that skipped the detector.
    pub skipped: u64,
    /// Mean power of the node, watts; `None` without a figure.
    pub watts: Option<f64>,
    /// What the audit has compared.
    pub audit: AuditSums,
}

/// Why the knob has its value.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TargetStatus {
    /// Too little has been measured yet.
    Measuring,
    /// The target is not reached yet: the knob moves.
    Moving,
    /// The target is held.
    Held,
    /// The target is exceeded, and the knob is at the end of its range.
    MoreThanKept,
    /// It cannot be met inside the range: the knob is at the end.
    CannotBeMet,
    /// No frames arrive.
    NoFrames,
    /// There is no figure of power.
    NoPower,
    /// Nothing is audited, so that no recall is known.
    NoAudit,
}

impl TargetStatus {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Measuring,
        Self::Moving,
        Self::Held,
        Self::MoreThanKept,
        Self::CannotBeMet,
        Self::NoFrames,
        Self::NoPower,
        Self::NoAudit,
    ];

    /// Its name, as in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Measuring => "measuring",
            Self::Moving => "moving",
            Self::Held => "held",
            Self::MoreThanKept => "more_than_kept",
            Self::CannotBeMet => "cannot_be_met",
            Self::NoFrames => "no_frames",
            Self::NoPower => "no_power",
            Self::NoAudit => "no_audit",
        }
    }

    /// In words.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Measuring => "too little has been measured yet",
            Self::Moving => "on the way to the target",
            Self::Held => "the target is held",
            Self::MoreThanKept => "more than kept, at the end of the range",
            Self::CannotBeMet => "cannot be met inside the range",
            Self::NoFrames => "no frames come",
            Self::NoPower => "there is no figure of power",
            Self::NoAudit => "nothing is audited",
        }
    }
}

/// The state of a target.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetState {
    /// What is measured of it; for recall the lower end of its interval. Absent before anything is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub actual: Option<f64>,
    /// The knob's value in force.
    pub knob: f64,
    /// Why it has that value.
    pub status: TargetStatus,
    /// Seconds in which the target could not be met inside the range.
    pub unmet_s: f64,
    /// How often that began.
    pub unmet: u64,
    /// For recall, the boxes that the figure rests on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boxes: Option<u64>,
}

/// The knob as a controller has it.
#[derive(Clone, Copy, Debug)]
struct Lever {
    /// Logarithm of the value.
    x: f64,
    least: f64,
    most: f64,
    /// The value: to the last digit what was given, where it has not moved, and the ends of the range.
    value: f64,
    range: KnobRange,
}

impl Lever {
    /// At the value `knob`, or the end of the range that is nearer.
    fn new(range: KnobRange, knob: f64) -> Self {
        let (least, most) = range.logarithms();
        // No number is at no end; the accurate one is the safe one.
        let value = if knob > 0.0 { knob } else { range.least };
        let value = value.clamp(range.least, range.most);
        Self {
            x: value.ln().clamp(least, most),
            least,
            most,
            value,
            range,
        }
    }

    /// Moves by `by`, as far as the range goes.
    fn push(&mut self, by: f64) {
        self.x = (self.x + by).clamp(self.least, self.most);
        self.value = if self.is_at_least() {
            self.range.least
        } else if self.is_at_most() {
            self.range.most
        } else {
            self.x.exp()
        };
    }

    fn is_at_least(&self) -> bool {
        self.x <= self.least
    }

    fn is_at_most(&self) -> bool {
        self.x >= self.most
    }
}

/// What a rule of control made of a step.
#[derive(Clone, Copy, Debug)]
struct Verdict {
    actual: Option<f64>,
    status: TargetStatus,
    boxes: Option<u64>,
}

#[derive(Clone, Debug)]
enum Control {
    Load(LoadControl),
    Recall(Box<RecallControl>),
}

/// Holds a target by moving a knob.
#[derive(Clone, Debug)]
pub struct TargetController {
    target: Target,
    lever: Lever,
    control: Control,
    unmet_s: f64,
    unmet: u64,
    could_be_met: bool,
}

impl TargetController {
    /// A controller that begins at the value `knob`, moved into the range where it lies outside.
    ///
    /// # Errors
    /// [`TargetError::Value`] when the target's value makes no sense.
    pub fn new(target: Target, range: KnobRange, knob: f64) -> Result<Self, TargetError> {
        Ok(Self {
            target: target.check()?,
            lever: Lever::new(range, knob),
            control: match target {
                Target::Recall(wanted) => Control::Recall(Box::new(RecallControl::new(wanted))),
                _ => Control::Load(LoadControl::new(target)),
            },
            unmet_s: 0.0,
            unmet: 0,
            could_be_met: true,
        })
    }

    /// What it holds.
    pub const fn target(&self) -> Target {
        self.target
    }

    /// The knob's value.
    pub const fn knob(&self) -> f64 {
        self.lever.value
    }

    /// Takes what was measured since the last step and moves the knob. Once a second, about; a step over no time, or over
    /// none that is a number, changes nothing.
    pub fn step(&mut self, measured: &Measured) -> TargetState {
        let seconds = if measured.seconds > 0.0 && measured.seconds.is_finite() {
            measured.seconds
        } else {
            0.0
        };
        let verdict = match &mut self.control {
            Control::Load(load) => load.step(measured, seconds, &mut self.lever),
            Control::Recall(recall) => recall.step(measured, &mut self.lever),
        };
        let cannot = verdict.status == TargetStatus::CannotBeMet;
        if cannot {
            self.unmet_s += seconds;
            self.unmet += u64::from(self.could_be_met);
        }
        self.could_be_met = !cannot;
        TargetState {
            actual: verdict.actual,
            knob: self.knob(),
            status: verdict.status,
            unmet_s: self.unmet_s,
            unmet: self.unmet,
            boxes: verdict.boxes,
        }
    }
}
