//! Targets instead of a fixed threshold: a slow controller moves a policy's threshold until the target is met.
//!
//! [`TargetController::step`] receives the measurements once per second and returns the threshold's value and the
//! reason. It is an integral controller in the logarithm of the threshold. The threshold's value *is* the integral and
//! never leaves its range, so it does not wind up while a target cannot be met, and reacts at once when it can.
//!
//! The load targets ([`Target::SkipRate`], [`Target::Watts`]) settle within a minute. [`Target::Recall`] follows the
//! audit ([`crate::audit`]) and moves only after enough boxes have been compared since its last move.

mod load;
mod recall;
#[cfg(test)]
mod tests;

use crate::audit::AuditSums;
use crate::policy::{ThresholdSpec, short};
use load::LoadControl;
use recall::RecallControl;
use serde::{Deserialize, Serialize};

/// The target to hold. In JSON, one field: `{"skip_rate": 0.5}`.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// Recall against the detector: the lower end of its interval is held at this value.
    Recall(f64),
    /// Share of frames that skip the detector.
    SkipRate(f64),
    /// Mean power of the node, watts.
    Watts(f64),
}

impl Target {
    /// The names of all targets.
    pub const NAMES: [&'static str; 3] = ["recall", "skip_rate", "watts"];

    /// Returns the target's name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Recall(_) => "recall",
            Self::SkipRate(_) => "skip_rate",
            Self::Watts(_) => "watts",
        }
    }

    /// Returns the target's value.
    pub const fn value(self) -> f64 {
        match self {
            Self::Recall(value) | Self::SkipRate(value) | Self::Watts(value) => value,
        }
    }

    /// Returns the target with `name` and `value`; `None` if the name is unknown.
    pub fn named(name: &str, value: f64) -> Option<Self> {
        let all = [
            Self::Recall(value),
            Self::SkipRate(value),
            Self::Watts(value),
        ];
        all.into_iter().find(|target| target.name() == name)
    }

    /// Returns the target if its value can be held.
    ///
    /// # Errors
    /// [`TargetError::Value`] otherwise, including NaN and infinities.
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
    /// Example: `skip_rate 0.5`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.name(), short(self.value()))
    }
}

/// The reason why a target cannot be held.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TargetError {
    /// The target's value is invalid.
    #[error("`{name}` must be a number from {} to {}, not {value}", short(*.least), short(*.most))]
    Value {
        /// The target's name.
        name: &'static str,
        /// Smallest value.
        least: f64,
        /// Largest value.
        most: f64,
        /// The value given.
        value: f64,
    },
    /// The policy has no threshold that a controller can move.
    #[error(
        "a target moves `u` or `lambda`, and policy `{policy}` has {}",
        threshold.map_or_else(|| "no threshold".to_owned(), |threshold| format!("`{threshold}`"))
    )]
    Policy {
        /// The policy.
        policy: String,
        /// The policy's threshold.
        threshold: Option<&'static str>,
    },
    /// The range is invalid or not within the threshold's.
    #[error("the range of `{name}` must lie within {} to {}, and its ends must differ", short(*.least), short(*.most))]
    Range {
        /// The threshold's name.
        name: &'static str,
        /// The threshold's smallest value.
        least: f64,
        /// The threshold's largest value.
        most: f64,
    },
}

/// The range within which a controller moves a threshold.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThresholdRange {
    /// Smallest value: the most accurate one.
    pub least: f64,
    /// Largest value that accuracy still allows.
    pub most: f64,
}

impl ThresholdRange {
    /// Returns the range within which a controller moves `threshold`: the given ends, or by default `u` 1.5e-4 to 2e-3,
    /// `lambda` 0.05 to 1.2. On the recorded sequences the upper ends cost 11 and 2.4 points of AP@50 against a detector
    /// on every frame.
    ///
    /// # Errors
    /// [`TargetError`] if a controller cannot move the threshold, or the range is not within the threshold's.
    pub fn of(
        policy: &str,
        threshold: Option<&ThresholdSpec>,
        least: Option<f64>,
        most: Option<f64>,
    ) -> Result<Self, TargetError> {
        let (threshold, default_least, default_most) = match threshold {
            Some(threshold) if threshold.name == "u" => (threshold, 1.5e-4, 2e-3),
            Some(threshold) if threshold.name == "lambda" => (threshold, 0.05, 1.2),
            other => {
                return Err(TargetError::Policy {
                    policy: policy.to_owned(),
                    threshold: other.map(|threshold| threshold.name),
                });
            }
        };
        let range = Self {
            least: least.unwrap_or(default_least),
            most: most.unwrap_or(default_most),
        };
        let inside = threshold.check(range.least).is_ok() && threshold.check(range.most).is_ok();
        if inside && range.least > 0.0 && range.least < range.most {
            Ok(range)
        } else {
            Err(TargetError::Range {
                name: threshold.name,
                least: threshold.minimum,
                most: threshold.maximum,
            })
        }
    }
}

/// Measurements since the previous step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// Time since the previous step, seconds.
    pub seconds: f64,
    /// Number of frames.
    pub frames: u64,
    /// Frames that skipped the detector.
    pub skipped: u64,
    /// Mean power of the node, watts; `None` if unknown.
    pub watts: Option<f64>,
    /// Results of the audit.
    pub audit: AuditSums,
}

/// The reason for the threshold's value.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TargetStatus {
    /// Too little has been measured yet.
    Measuring,
    /// The target is not reached yet: the threshold moves.
    Moving,
    /// The target is held.
    Held,
    /// The target is exceeded, and the threshold is at the end of its range.
    MoreThanKept,
    /// The target cannot be met inside the range: the threshold is at the end.
    CannotBeMet,
    /// No frames arrive.
    NoFrames,
    /// Power is unknown.
    NoPower,
    /// Nothing is audited, so the recall is unknown.
    NoAudit,
}

impl TargetStatus {
    /// All statuses.
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

    /// Returns the name used in messages.
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

    /// Returns the human-readable form.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Measuring => "not enough data yet",
            Self::Moving => "not reached yet",
            Self::Held => "the target is held",
            Self::MoreThanKept => "exceeded, at the end of the threshold's range",
            Self::CannotBeMet => "cannot be met within the threshold's range",
            Self::NoFrames => "no frames arrive",
            Self::NoPower => "the node has no power figures",
            Self::NoAudit => "no frames are audited",
        }
    }
}

/// The state of a target.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetState {
    /// The measured value; for recall, the lower end of its interval. Absent before the first measurement.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub actual: Option<f64>,
    /// The threshold's current value.
    pub threshold: f64,
    /// The reason for that value.
    pub status: TargetStatus,
    /// Time during which the target could not be met inside the range, seconds.
    pub unmet_s: f64,
    /// Number of times that this began.
    pub unmet: u64,
    /// For recall, the number of boxes behind the measured value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boxes: Option<u64>,
}

/// The state of the threshold in a controller.
#[derive(Clone, Copy, Debug)]
struct Lever {
    /// The value: exactly the given one before the first move, and exact at the ends of the range.
    value: f64,
    range: ThresholdRange,
}

impl Lever {
    /// Creates a lever at `threshold`, clamped to the range.
    fn new(range: ThresholdRange, threshold: f64) -> Self {
        // NaN and non-positive values have no logarithm; the accurate end is the safe one.
        let value = if threshold > 0.0 {
            threshold.clamp(range.least, range.most)
        } else {
            range.least
        };
        Self { value, range }
    }

    /// Returns the logarithm of the value.
    fn logarithm(&self) -> f64 {
        self.value.ln()
    }

    /// Moves the logarithm by `by`, clamped to the range.
    fn push(&mut self, by: f64) {
        let ThresholdRange { least, most } = self.range;
        let moved = self.logarithm() + by;
        self.value = if moved <= least.ln() {
            least
        } else if moved >= most.ln() {
            most
        } else {
            moved.exp()
        };
    }

    fn is_at_least(&self) -> bool {
        self.value <= self.range.least
    }

    fn is_at_most(&self) -> bool {
        self.value >= self.range.most
    }
}

/// The result of a control step.
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

/// Holds a target by moving a threshold.
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
    /// Creates a controller that begins at the value `threshold`, clamped to the range.
    ///
    /// # Errors
    /// [`TargetError::Value`] if the target's value is invalid.
    pub fn new(target: Target, range: ThresholdRange, threshold: f64) -> Result<Self, TargetError> {
        Ok(Self {
            target: target.check()?,
            lever: Lever::new(range, threshold),
            control: match target {
                Target::Recall(wanted) => Control::Recall(Box::new(RecallControl::new(wanted))),
                _ => Control::Load(LoadControl::new(target)),
            },
            unmet_s: 0.0,
            unmet: 0,
            could_be_met: true,
        })
    }

    /// The target to hold.
    pub const fn target(&self) -> Target {
        self.target
    }

    /// The threshold's current value.
    pub const fn threshold(&self) -> f64 {
        self.lever.value
    }

    /// Processes the measurements since the last step and moves the threshold. Call it about once per second; a step
    /// whose time is not positive and finite changes nothing.
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
            threshold: self.threshold(),
            status: verdict.status,
            unmet_s: self.unmet_s,
            unmet: self.unmet,
            boxes: verdict.boxes,
        }
    }
}
