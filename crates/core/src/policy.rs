//! Policies: the trait that all policies share, the evidence that they ask for, and the frame state.
//!
//! A policy asks for evidence step by step. It learns that a frame exists, names the evidence that it needs next,
//! receives it, and finally returns the frame's state and boxes:
//!
//! ```text
//! begin(frame) ─▶ Nothing ───────────────────────────────▶ finish ─▶ P
//!              ─▶ Screen ─▶ answer(empty) ─▶ Nothing ────▶ finish ─▶ E
//!              │          └▶ answer(not empty) ─▶ Detections …
//!              ─▶ Detections ─▶ answer(detections) ──────▶ finish ─▶ I, AI, E+I
//! ```
//!
//! | `name[:argument]` | the detector runs | on the other frames | source |
//! | --- | --- | --- | --- |
//! | `albireo[:u]` | when an object's uncertainty reaches `u`, or a cap is due; without objects when the screen reports "not empty" | predicted boxes; none in an empty scene | the paper |
//! | `vanilla` | on every frame | | the paper's baseline |
//! | `fixed-skip[:n]` | on every n-th frame | the last boxes again (profile `paper`) or predicted ones (`reference`) | the paper's baseline |
//! | `ctd[:threshold]` | when the confidence in a prediction falls below the threshold, without objects, and after 8 frames | predicted boxes | Ding et al. |
//! | `statues[:component_size]` | when more pixels than this changed in one piece since the last frame | the last boxes again | Kim et al. |
//! | `erd-only` | when the screen, asked on every frame, reports "not empty" | none | the paper's baseline |
//! | `kill-only[:u]` | as albireo, but without the screen: always without objects | predicted boxes | ablation: a size without velocity (8 dimensions), no rescue |
//! | `kill+erd[:u]` | as albireo | as albireo | ablation: a size without velocity (8 dimensions), no rescue |
//! | `kill+erd-10d[:u]` | as albireo | as albireo | ablation: no rescue |
//! | `expected-loss[:lambda]` | when the expected loss of another predicted frame exceeds the price λ of a call | predicted boxes | our own |
//! | `fixed-skip-in-tracker[:n]` | on every n-th frame | predicted boxes of expected-loss | comparison: the object keeping alone |
//! | `even-skip-in-tracker[:skip_rate]` | evenly spaced, at any rate | predicted boxes of expected-loss | comparison: the object keeping alone |
//! | `expected-loss+flow[:lambda]` and the two above with `+flow` | the same | boxes followed by optical flow in a small grey picture | our own |
//!
//! [`WithPause`] adds a pause on an empty road to those that call the detector whenever nothing is tracked, and one for
//! pictures without news to all that look at no pictures themselves.
//!
//! A policy uses no clock, picture format or network, and a frame that needs no evidence costs no decoding. The live
//! node, the evaluation and the tests all drive policies through [`decide`], with their own evidence.

use crate::detection::{ClassId, Detection, ObjectId};
use crate::geometry::{BoundingBox, PictureSize};
use serde::{Deserialize, Serialize};

mod albireo;
mod albireo_settings;
mod baselines;
mod cause;
mod config;
mod decide;
mod detector_boxes;
mod empty_road;
mod expected_loss;
mod fixed_skip;
mod late;
mod progress;
mod published;
mod published_threshold;
mod record;
mod settled;
mod still;
#[cfg(test)]
pub(crate) mod tests;
mod tracker;
mod vanilla;

pub use crate::flow::GreyPicture;
pub use albireo::Albireo;
pub use albireo_settings::{
    AlbireoSettings, DetectorFrameBoxes, PeriodicCap, Profile, ReportedConfidence,
};
pub(crate) use baselines::{Ablation, ErdOnly};
pub use baselines::{Ctd, CtdSettings, Statues, StatuesSettings};
pub use cause::CallCause;
pub use config::{PolicyConfig, PolicyConfigError, known_policies};
pub use decide::{EvidenceAtHand, FrameEvidence, decide};
pub use empty_road::{EmptyRoad, PauseFrames, WithPause, no_pause};
pub use expected_loss::{ExpectedLoss, ExpectedLossSettings, InTracker, Pixels, Trigger};
pub use fixed_skip::{FixedSkip, FixedSkipSettings, SkippedBoxes};
pub use late::{CannotRewind, LatePolicy, NotPending};
pub use published::MinConfidence;
pub use published_threshold::published_threshold;
pub use record::ObjectRecord;
pub use settled::{SettledFrame, Settler};
pub use still::PassCause;
pub use vanilla::Vanilla;

/// The information about a frame before its picture is decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHead {
    /// Index of the frame in its stream, counting lost frames. The first frame seen has its own sequence number or 0.
    pub index: u64,
    /// Frames since the previously begun one: 1 if none was lost. Filters advance by this many steps.
    pub step: u32,
    /// Size of the picture.
    pub picture: PictureSize,
}

/// The evidence that a policy needs next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Need {
    /// Nothing more: call [`Policy::finish`].
    #[default]
    Nothing,
    /// The verdict of the empty-scene screen.
    Screen,
    /// The grey picture at half its size in each direction.
    GreyPicture,
    /// The grey picture at a whole fraction of its size (a half, a quarter, …): the smallest with at least this many
    /// columns, or the full size if the picture has fewer than twice as many.
    SmallGreyPicture {
        /// Columns.
        width: u32,
    },
    /// The detector's detections.
    Detections,
}

/// The answer to a [`Need`].
#[derive(Clone, Copy, Debug)]
pub enum Evidence<'a> {
    /// The empty-scene screen's verdict.
    Screen {
        /// True if nothing is in view.
        empty: bool,
    },
    /// The requested grey picture.
    GreyPicture(GreyPicture<'a>),
    /// The detections, in the detector's order.
    Detections(&'a [Detection]),
    /// The evidence is not available for this frame (the session failed or took too long). A policy that asked for the
    /// screen continues as after "not empty"; one that asked for the grey picture, as if the picture had changed or
    /// without it; one that asked for detections answers the frame from its state and marks the outcome `degraded`.
    Unavailable,
}

/// The state of a frame; every frame has exactly one (paper, table of frame states).
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
pub enum FrameState {
    /// The screen reported "empty", or the frame was passed over in a pause and shows nothing; the detector was skipped.
    E,
    /// The boxes are predicted or repeated from an earlier frame; the detector was skipped.
    #[default]
    P,
    /// The screen reported "not empty"; the detector ran.
    #[serde(rename = "E+I")]
    EI,
    /// The detector ran.
    I,
    /// The detector ran and at least one object was rescued.
    AI,
}

impl FrameState {
    /// All five states, in the order of reports.
    pub const ALL: [Self; 5] = [Self::E, Self::P, Self::EI, Self::I, Self::AI];

    /// The name on the wire: `E`, `P`, `E+I`, `I` or `AI`.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::E => "E",
            Self::P => "P",
            Self::EI => "E+I",
            Self::I => "I",
            Self::AI => "AI",
        }
    }

    /// True if the detector was skipped (E and P): these frames make up the skip rate.
    pub const fn is_skipped(self) -> bool {
        matches!(self, Self::E | Self::P)
    }
}

impl std::fmt::Display for FrameState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// The source of a reported box.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BoxSource {
    /// The detector found it in this frame.
    Detected,
    /// The detector did not run on this frame; the box comes from the filter or an earlier frame.
    Predicted,
    /// The detector did not run on this frame, but optical flow followed the object into it.
    Followed,
    /// The detector ran and missed the object; the filter predicts that it is still there. Only a policy with rescues
    /// then marks the frame [`FrameState::AI`]: `ctd` does not.
    Rescued,
}

/// One reported box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputBox {
    /// Box in normalised coordinates, not clipped to the picture.
    pub bounding_box: BoundingBox,
    /// Class, by the detector's number.
    pub class: ClassId,
    /// The confidence to report, 0 to 1.
    pub confidence: f64,
    /// Source of the box.
    pub source: BoxSource,
    /// Object that the box belongs to; `None` under a policy that keeps no objects.
    pub object: Option<ObjectId>,
    /// True if the object is confirmed.
    pub confirmed: bool,
}

/// The result of a frame. It is passed in again for each frame to reuse its buffer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The frame's state.
    pub state: FrameState,
    /// Largest uncertainty τ over the active objects before the decision; `None` without objects.
    pub tau_max: Option<f64>,
    /// Number of active objects before the decision.
    pub active: usize,
    /// True if the detector was needed but not available; the boxes are predictions.
    pub degraded: bool,
    /// The reason for the detector call; `None` on a frame that needed none.
    pub cause: Option<CallCause>,
    /// The reason why a pause passed over the frame; `None` if none did.
    pub passed: Option<PassCause>,
    /// The boxes to report.
    pub boxes: Vec<OutputBox>,
}

/// The threshold of a policy, which a user may change while it runs: its name, range and default.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ThresholdSpec {
    /// Name in configuration, messages and reports: `u`, `lambda`, …
    pub name: &'static str,
    /// The effect of changing it, in one sentence.
    pub meaning: &'static str,
    /// Smallest value allowed.
    pub minimum: f64,
    /// Largest value allowed.
    pub maximum: f64,
    /// Default value.
    pub default: f64,
    /// Lower end of a slider: below it hardly anything is saved.
    pub useful_minimum: f64,
    /// Upper end of a slider: above it hardly anything more is saved, at a high price.
    pub useful_maximum: f64,
}

/// The error for a value that is outside the threshold's range, or for a policy without a threshold.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InvalidThreshold {
    /// The policy has no threshold.
    #[error("policy `{policy}` has no threshold to change")]
    Absent {
        /// The policy's name.
        policy: &'static str,
    },
    /// The value is invalid.
    #[error(
        "`{name}` must be a number from {} to {}, not {value}",
        short(*.minimum),
        short(*.maximum)
    )]
    OutOfRange {
        /// The threshold's name.
        name: &'static str,
        /// Smallest value allowed.
        minimum: f64,
        /// Largest value allowed.
        maximum: f64,
        /// The value given.
        value: f64,
    },
}

/// Formats a number in short form: `0.3`, `100`, `1e-9`.
pub fn short(value: f64) -> String {
    if value == 0.0 || (0.001..1e6).contains(&value.abs()) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

impl ThresholdSpec {
    /// Returns the range of values, human-readable.
    pub fn range(&self) -> String {
        format!(
            "a number from {} to {}",
            short(self.minimum),
            short(self.maximum)
        )
    }

    /// Returns `value` if it is a number inside the range.
    ///
    /// # Errors
    /// [`InvalidThreshold::OutOfRange`] otherwise, including NaN and infinities.
    pub fn check(&self, value: f64) -> Result<f64, InvalidThreshold> {
        // NaN compares false to everything and is rejected.
        if value >= self.minimum && value <= self.maximum {
            Ok(value)
        } else {
            Err(InvalidThreshold::OutOfRange {
                name: self.name,
                minimum: self.minimum,
                maximum: self.maximum,
                value,
            })
        }
    }
}

/// Decides each frame of a stream; driven by [`decide`].
///
/// Calls for one frame: [`begin`](Policy::begin), then [`answer`](Policy::answer) until the last need is
/// [`Need::Nothing`], then [`finish`](Policy::finish). A frame may be abandoned after `begin` (for example because its
/// picture is broken) by beginning the next one: the state stays advanced, exactly as after a lost frame.
pub trait Policy: Send + Sync {
    /// The name in configuration and reports.
    fn name(&self) -> &'static str;

    /// The threshold that a user may change, if there is one.
    fn threshold_spec(&self) -> Option<ThresholdSpec> {
        None
    }

    /// The threshold's current value.
    fn threshold(&self) -> Option<f64> {
        None
    }

    /// Sets the threshold for the frames that follow; to be called between frames, before a `begin`.
    ///
    /// # Errors
    /// [`InvalidThreshold`] if there is no threshold or the value is out of its range; nothing changes then.
    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        let _ = value;
        let policy = self.name();
        Err(InvalidThreshold::Absent { policy })
    }

    /// Sets the share of the threshold that the frames that follow may fall short of and still call the detector, because
    /// it runs anyway for another camera: with 0.1, from 90 % of the threshold on. 0, as at the start, for never. Without
    /// effect where nothing is tracked, and on policies whose calls do not weigh anything (all but `albireo` with its
    /// ablations, and `expected-loss`).
    fn set_join(&mut self, share: f64) {
        let _ = share;
    }

    /// Begins a frame: advances the filters by `frame.step` and returns the first need.
    fn begin(&mut self, frame: FrameHead) -> Need;

    /// Receives the requested evidence and returns the next need.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need;

    /// The grey pictures that this policy may ask for; `None` if it never asks for any.
    fn pictures(&self) -> Option<Need> {
        None
    }

    /// The maximum number of consecutive frames without the detector while objects are followed, if the policy limits
    /// them.
    fn longest_pause(&self) -> Option<u32> {
        None
    }

    /// True if it asks a screen, and without one the detector, only because nothing is tracked: the policies that a pause on
    /// an empty road is for. `expected-loss` looks at an empty road less often by itself, and loses less by a higher price
    /// than by a pause (docs/method.md).
    fn takes_pause(&self) -> bool {
        false
    }

    /// True if frames can be answered by prediction before their evidence arrives, as [`LatePolicy`] requires.
    fn can_rewind(&self) -> bool {
        false
    }

    /// Saves the state of the current frame and replaces the previously saved one. Does nothing unless the policy
    /// [can rewind](Policy::can_rewind).
    fn save(&mut self) {}

    /// Returns to the last saved state, any number of times; settings and the threshold keep their current values. Does
    /// nothing before the first [`save`](Policy::save).
    fn rewind(&mut self) {}

    /// Ends the frame and overwrites `outcome` with its state and boxes.
    fn finish(&mut self, outcome: &mut Outcome);

    /// Forgets all objects, as at the start of a stream. Keeps settings and the threshold's value.
    fn reset(&mut self);

    /// Calls `visit` with the record of every object kept, oldest first, for traces and evaluation. A policy that keeps
    /// no objects visits none.
    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        let _ = visit;
    }

    /// The number of detections rejected so far because their numbers give no valid box (not finite, sides of zero or
    /// less, absurdly large) or confidence. They are neither followed nor reported.
    fn rejected_detections(&self) -> u64 {
        0
    }
}
