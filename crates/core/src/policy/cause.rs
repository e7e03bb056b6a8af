//! Reasons for calling the detector.

use serde::{Deserialize, Serialize};

/// Why the detector was called for a frame, whether or not it answered. Where several things call it at once, the one
/// named first here is said.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CallCause {
    /// A confirmed object's uncertainty has reached the threshold; under `ctd`, a prediction is trusted too little.
    Uncertain,
    /// Only objects that are not confirmed yet are that uncertain: they are new.
    NewObject,
    /// The boxes expected to be lost without it are worth a call (`expected-loss`).
    ExpectedLoss,
    /// An object has gone without the detector for as long as one may.
    ObjectCap,
    /// The camera has gone without the detector for as long as it may.
    PeriodicCap,
    /// The screen found something in view.
    Screen,
    /// The screen would have answered "empty"; the detector checks it at random.
    Audit,
    /// The screen answered "empty" more often in a row than the limit allows.
    EmptyLimit,
    /// No object is tracked, and no screen decides whether the scene is empty.
    NoObjects,
    /// It is the first frame of the stream.
    Start,
    /// The detector was called for before and has not answered since (`statues`).
    Retry,
    /// The picture has changed, or may have changed (`statues`).
    Changed,
    /// A schedule that knows nothing of the scene (`fixed-skip` and its like).
    Schedule,
    /// The policy calls it on every frame (`vanilla`).
    EveryFrame,
}

impl CallCause {
    /// All of them, in the order they are counted.
    pub const ALL: [Self; 14] = [
        Self::Uncertain,
        Self::NewObject,
        Self::ExpectedLoss,
        Self::ObjectCap,
        Self::PeriodicCap,
        Self::Screen,
        Self::Audit,
        Self::EmptyLimit,
        Self::NoObjects,
        Self::Start,
        Self::Retry,
        Self::Changed,
        Self::Schedule,
        Self::EveryFrame,
    ];

    /// The name on the wire.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Uncertain => "uncertain",
            Self::NewObject => "new_object",
            Self::ExpectedLoss => "expected_loss",
            Self::ObjectCap => "object_cap",
            Self::PeriodicCap => "periodic_cap",
            Self::Screen => "screen",
            Self::Audit => "audit",
            Self::EmptyLimit => "empty_limit",
            Self::NoObjects => "no_objects",
            Self::Start => "start",
            Self::Retry => "retry",
            Self::Changed => "changed",
            Self::Schedule => "schedule",
            Self::EveryFrame => "every_frame",
        }
    }
}
