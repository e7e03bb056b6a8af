//! What decides a frame: the trait all policies share, the evidence they ask for, and the frame state.
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
//! | `albireo[:u]` | when an object's uncertainty reaches `u`, or a cap is due; without objects when the screen says "not empty" | predicted boxes; none in an empty scene | the paper |
//! | `vanilla` | on every frame | | the paper's baseline |
//! | `fixed-skip[:n]` | on every n-th frame | the last boxes again (profile `paper`) or predicted ones (`reference`) | the paper's baseline |
//! | `ctd[:threshold]` | when the confidence in a prediction falls below the threshold, without objects, and after 8 frames | predicted boxes | Ding et al. |
//! | `statues[:component_size]` | when more pixels than this changed in one piece since the last frame | the last boxes again | Kim et al. |
//! | `erd-only` | when the screen, asked on every frame, says "not empty" | none | the paper's baseline |
//! | `kill-only[:u]` | as albireo, but without the screen: always without objects | predicted boxes | ablation: a size without velocity (8 dimensions), no rescue |
//! | `kill+erd[:u]` | as albireo | as albireo | ablation: a size without velocity (8 dimensions), no rescue |
//! | `kill+erd-10d[:u]` | as albireo | as albireo | ablation: no rescue |
//! | `expected-loss[:lambda]` | when the expected loss of another predicted frame exceeds the price λ of a call | predicted boxes | our own |
//! | `fixed-skip-in-tracker[:n]` | on every n-th frame | predicted boxes of expected-loss | comparison: the object keeping alone |
//! | `even-skip-in-tracker[:skip_rate]` | evenly spaced, at any rate | predicted boxes of expected-loss | comparison: the object keeping alone |
//! | `expected-loss+flow[:lambda]` and the two above with `+flow` | the same | boxes followed by optical flow in a small grey picture | our own |
//!
//! It knows no clock, no picture format and no network, and a frame that needs nothing costs no decoding. The live
//! node, the evaluation and the tests all drive it by [`decide`], with their own evidence.

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
mod expected_loss;
mod fixed_skip;
mod late;
mod published;
mod published_threshold;
mod record;
mod reporting;
mod settled;
#[cfg(test)]
pub(crate) mod tests;
mod tracker;
mod vanilla;

pub use albireo::Albireo;
pub use albireo_settings::{AlbireoSettings, Profile};
pub use albireo_settings::{DetectorFrameBoxes, PeriodicCap, ReportedConfidence};
pub(crate) use baselines::{Ablation, ErdOnly};
pub use baselines::{Ctd, CtdSettings, Statues, StatuesSettings};
pub use cause::CallCause;
pub use config::{PolicyConfig, PolicyConfigError};
pub use decide::{EvidenceAtHand, FrameEvidence, decide};
pub use expected_loss::{ExpectedLoss, ExpectedLossSettings, InTracker, Pixels, Trigger};
pub use fixed_skip::FixedSkip;
pub use fixed_skip::FixedSkipSettings;
pub use fixed_skip::SkippedBoxes;
pub use late::{CannotRewind, LatePolicy, NotPending};
pub use published::MinConfidence;
pub use published_threshold::published_threshold;
pub use record::ObjectRecord;
pub use settled::{SettledFrame, Settler};
pub use vanilla::Vanilla;

/// What a policy knows about a frame before its picture is decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHead {
    /// Index of the frame in its stream, counting lost frames too. The first frame seen has its own
    /// sequence number or 0.
    pub index: u64,
    /// Frames since the one begun before it: 1 when none was lost. Filters advance by this many steps.
    pub step: u32,
    /// Size of the picture.
    pub picture: PictureSize,
}

/// What a policy needs to know next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Nothing more: call [`Policy::finish`].
    Nothing,
    /// The verdict of the empty-scene screen.
    Screen,
    /// The picture in grey at half its size in each direction.
    GreyPicture,
    /// The picture in grey at a whole fraction of its size (a half, a quarter, …) that leaves at least this many columns,
    /// as small as that allows; as it is when it has less than twice as many.
    SmallGreyPicture {
        /// Columns.
        width: u32,
    },
    /// The detector's detections.
    Detections,
}

/// A grey picture, row by row, without padding.
#[derive(Clone, Copy, Debug)]
pub struct GreyPicture<'a> {
    /// Size in pixels.
    pub size: PictureSize,
    /// `width * height` luma values.
    pub pixels: &'a [u8],
}

/// The answer to a [`Need`].
#[derive(Clone, Copy, Debug)]
pub enum Evidence<'a> {
    /// The empty-scene screen's verdict: whether it says that nothing is in view.
    Screen {
        /// True for "nothing in view".
        empty: bool,
    },
    /// The grey picture asked for.
    GreyPicture(GreyPicture<'a>),
    /// What the detector found, in the detector's order.
    Detections(&'a [Detection]),
    /// The evidence is not available for this frame (the session failed or took too long). A policy that asked for the
    /// screen continues as after "not empty"; one that asked for the grey picture, as if the picture had changed or
    /// without it; one that asked for detections answers the frame from its state and marks the outcome `degraded`.
    Unavailable,
}

/// The state of a frame; every frame has exactly one (paper, table of frame states).
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum FrameState {
    /// The screen said "empty"; the detector was skipped.
    E,
    /// Boxes are predicted, or those of an earlier frame again; the detector was skipped.
    P,
    /// The screen said "not empty"; the detector ran.
    #[serde(rename = "E+I")]
    EI,
    /// The detector ran.
    I,
    /// The detector ran and at least one object was rescued.
    AI,
}

impl FrameState {
    /// All five, in the order they are reported.
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

    /// Whether the detector was skipped (E and P): these frames make the skip rate.
    pub const fn is_skipped(self) -> bool {
        matches!(self, Self::E | Self::P)
    }
}

impl std::fmt::Display for FrameState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Where a reported box comes from.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BoxSource {
    /// The detector found it in this frame.
    Detected,
    /// The detector did not look at this frame; the filter says so, or an earlier frame does.
    Predicted,
    /// The detector did not look at this frame, but optical flow followed the object into it.
    Followed,
    /// The detector looked and missed it; the filter says it is still there. Only a policy that rescues
    /// makes the frame [`FrameState::AI`] by it: `ctd` does not.
    Rescued,
}

/// One reported box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputBox {
    /// Where, in normalised coordinates, not clipped to the picture.
    pub bounding_box: BoundingBox,
    /// Its class, by the detector's number.
    pub class: ClassId,
    /// The confidence to report, 0 to 1.
    pub confidence: f64,
    /// How it is known.
    pub source: BoxSource,
    /// Whose box it is; `None` under a policy that keeps no objects.
    pub object: Option<ObjectId>,
    /// Whether the object is confirmed.
    pub confirmed: bool,
}

/// What became of a frame. Kept and passed in again so that its buffer is reused.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The frame's state.
    pub state: FrameState,
    /// Largest uncertainty τ over the active objects before the decision; `None` without objects.
    pub tau_max: Option<f64>,
    /// Active objects before the decision.
    pub active: usize,
    /// The detector was needed but not available; the boxes are predictions.
    pub degraded: bool,
    /// Why the detector was called; `None` on a frame that did without it.
    pub cause: Option<CallCause>,
    /// The boxes to report.
    pub boxes: Vec<OutputBox>,
}

impl Default for Outcome {
    fn default() -> Self {
        Self {
            state: FrameState::P,
            tau_max: None,
            active: 0,
            degraded: false,
            cause: None,
            boxes: Vec::new(),
        }
    }
}

impl Outcome {
    /// A frame that is `state`, without objects or boxes so far. The buffer of boxes stays.
    fn clear(&mut self, state: FrameState, degraded: bool) {
        self.state = state;
        self.tau_max = None;
        self.active = 0;
        self.degraded = degraded;
        self.cause = None;
        self.boxes.clear();
    }
}

/// The one number of a policy that a user turns while it runs, as the policy declares it.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Knob {
    /// Its name in configuration, messages and reports: `u`, `lambda`, …
    pub name: &'static str,
    /// What turning it does, in one sentence.
    pub meaning: &'static str,
    /// Smallest value allowed.
    pub minimum: f64,
    /// Largest value allowed.
    pub maximum: f64,
    /// The value without configuration.
    pub default: f64,
    /// Where a slider begins: below it hardly anything is saved.
    pub useful_minimum: f64,
    /// Where a slider ends: above it hardly anything more is saved, at a high price.
    pub useful_maximum: f64,
}

/// A value outside a knob's range, or a knob that is not there.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum KnobError {
    /// The policy has nothing to turn.
    #[error("policy `{policy}` has no threshold to change")]
    Absent {
        /// The policy's name.
        policy: &'static str,
    },
    /// The value cannot be used.
    #[error(
        "`{name}` must be a number from {} to {}, not {value}",
        short(*.minimum),
        short(*.maximum)
    )]
    OutOfRange {
        /// The knob's name.
        name: &'static str,
        /// Smallest value allowed.
        minimum: f64,
        /// Largest value allowed.
        maximum: f64,
        /// What was given.
        value: f64,
    },
}

/// A number as a person writes it: `0.3`, `100`, `1e-9`.
pub fn short(value: f64) -> String {
    if value == 0.0 || (0.001..1e6).contains(&value.abs()) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

impl Knob {
    /// The range of its values, in words.
    pub fn range(&self) -> String {
        format!(
            "a number from {} to {}",
            short(self.minimum),
            short(self.maximum)
        )
    }

    /// `value` if it is a number inside the range.
    ///
    /// # Errors
    /// [`KnobError::OutOfRange`] otherwise, NaN and infinities included.
    pub fn check(&self, value: f64) -> Result<f64, KnobError> {
        // Written so that NaN, which compares false to everything, is refused.
        if value >= self.minimum && value <= self.maximum {
            Ok(value)
        } else {
            Err(KnobError::OutOfRange {
                name: self.name,
                minimum: self.minimum,
                maximum: self.maximum,
                value,
            })
        }
    }
}

/// What decides a frame. [`decide`] makes its calls.
///
/// Calls for one frame: [`begin`](Policy::begin), then [`answer`](Policy::answer) as long as the last
/// need was not [`Need::Nothing`], then [`finish`](Policy::finish). A frame may be given up after
/// `begin` (its picture turned out to be broken) by beginning the next one: what `begin` advanced stays
/// advanced, which is exactly what a lost frame does.
pub trait Policy: Send + Sync {
    /// The name used in configuration and reports.
    fn name(&self) -> &'static str;

    /// The number a user may turn, if there is one.
    fn knob(&self) -> Option<Knob> {
        None
    }

    /// The knob's value in force.
    fn knob_value(&self) -> Option<f64> {
        None
    }

    /// Turns the knob; takes effect with the next `begin`.
    ///
    /// # Errors
    /// [`KnobError`] if there is no knob or the value is out of its range; nothing changes then.
    fn set_knob(&mut self, value: f64) -> Result<(), KnobError> {
        let _ = value;
        let policy = self.name();
        Err(KnobError::Absent { policy })
    }

    /// A frame exists. Advances the filters by `frame.step` and says what is needed first.
    fn begin(&mut self, frame: FrameHead) -> Need;

    /// Takes the evidence asked for and says what is needed next.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need;

    /// The grey pictures that this policy may ask for; `None` when it never asks for any.
    fn pictures(&self) -> Option<Need> {
        None
    }

    /// Most frames that may follow each other without the detector while objects are followed, where the policy limits
    /// them.
    fn longest_pause(&self) -> Option<u32> {
        None
    }

    /// Whether frames can be answered by prediction before their evidence has come: what [`LatePolicy`] needs.
    fn can_rewind(&self) -> bool {
        false
    }

    /// Keeps the state of the current frame, in place of what was kept before. Nothing unless the policy
    /// [can rewind](Policy::can_rewind).
    fn save(&mut self) {}

    /// Returns to the state that was kept last, any number of times; settings and the knob's value stay as they are
    /// now. Nothing before the first [`save`](Policy::save).
    fn rewind(&mut self) {}

    /// Ends the frame: writes its state and boxes over `outcome`.
    fn finish(&mut self, outcome: &mut Outcome);

    /// Forgets all objects, as at the start of a stream. Settings and the knob's value stay.
    fn reset(&mut self);

    /// Shows the record of every object that is remembered, oldest first: for traces and evaluation.
    /// A policy that keeps no objects shows none.
    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        let _ = visit;
    }

    /// Detections refused so far because their numbers make no box (not finite, sides of zero or less,
    /// absurdly large) or no confidence. They are neither followed nor reported.
    fn rejected_detections(&self) -> u64 {
        0
    }
}
