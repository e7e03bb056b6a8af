//! The pauses of a node: for how long it may pass over frames of an empty road, or without news.

use crate::version::current_version;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// The pauses in a put, in a query's payload and in the answer to a query: `{"screen": {"pause_s": 0.2}}`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ScreenMessage {
    /// Version of the message; optional on input.
    #[serde(default = "current_version")]
    pub v: u32,
    /// The pauses.
    pub screen: Pauses,
}

/// Pauses, of all cameras: `{"pause_s": 0.2}`. What is left out stays as it is.
#[skip_serializing_none]
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Pauses {
    /// Seconds from one look at an empty road to the next; 0 looks at every frame.
    pub pause_s: Option<f64>,
    /// Seconds without a detection after which the road is empty.
    pub after_s: Option<f64>,
    /// Seconds from one look at a picture without news to the next; 0 compares no pictures.
    pub still_s: Option<f64>,
}
