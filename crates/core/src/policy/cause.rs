//! The reasons for detector calls.

use serde::{Deserialize, Serialize};

/// The reason why the detector was called for a frame, even if it did not answer. If several apply, the first in this
/// list is reported.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CallCause {
    /// A confirmed object's uncertainty reached the threshold; under `ctd`, the confidence in a prediction is too low.
    Uncertain,
    /// Only objects that are not yet confirmed are that uncertain: they are new.
    NewObject,
    /// The boxes expected to be lost without the detector are worth a call (`expected-loss`).
    ExpectedLoss,
    /// An object reached its maximum time without the detector.
    ObjectCap,
    /// The camera reached its maximum time without the detector.
    PeriodicCap,
    /// The screen found something in view.
    Screen,
    /// The screen would have reported "empty"; the detector checks it at random.
    Audit,
    /// The number of consecutive "empty" answers of the screen exceeds the limit.
    EmptyLimit,
    /// A pause has ended, on an empty road or because the picture had no news: the detector looks again.
    EmptyRoad,
    /// No object is tracked, and no screen decides whether the scene is empty.
    NoObjects,
    /// The frame is the first of the stream.
    Start,
    /// The detector has not answered since an earlier call (`statues`).
    Retry,
    /// The picture has changed, or may have changed (`statues`).
    Changed,
    /// A schedule that ignores the scene (`fixed-skip` and similar policies).
    Schedule,
    /// The policy calls the detector on every frame (`vanilla`).
    EveryFrame,
    /// A call was near, and the detector runs anyway for another camera.
    Joined,
}

impl CallCause {
    /// All causes, in counting order.
    pub const ALL: [Self; 16] = [
        Self::Uncertain,
        Self::NewObject,
        Self::ExpectedLoss,
        Self::ObjectCap,
        Self::PeriodicCap,
        Self::Screen,
        Self::Audit,
        Self::EmptyLimit,
        Self::EmptyRoad,
        Self::NoObjects,
        Self::Start,
        Self::Retry,
        Self::Changed,
        Self::Schedule,
        Self::EveryFrame,
        Self::Joined,
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
            Self::EmptyRoad => "empty_road",
            Self::NoObjects => "no_objects",
            Self::Start => "start",
            Self::Retry => "retry",
            Self::Changed => "changed",
            Self::Schedule => "schedule",
            Self::EveryFrame => "every_frame",
            Self::Joined => "joined",
        }
    }
}
