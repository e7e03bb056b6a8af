//! What a rollout or trial has been through.

use super::super::gate::{GateResult, Verdict};
use super::super::member::Millis;
use crate::named::named;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

named! {
    /// What kind of thing happened.
    pub enum What {
        /// It was begun.
        Begun = "begun",
        /// A stage was entered.
        Stage = "stage",
        /// The nodes have the value.
        Soaking = "soaking",
        /// The gates were judged.
        Judged = "judged",
        /// It is held.
        Held = "held",
        /// Nodes stayed away too long.
        Missed = "missed",
        /// The old value returns.
        Returning = "returning",
        /// The old value is back.
        Returned = "returned",
        /// All stages have passed, or the trial is over.
        Done = "done",
        /// Somebody paused it.
        Paused = "paused",
        /// Somebody resumed it.
        Resumed = "resumed",
        /// Somebody ordered the next stage.
        Next = "next",
        /// Somebody ordered the return.
        Return = "return",
        /// Somebody ended it.
        Stopped = "stopped",
    }
}

/// One thing that happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Entry {
    /// When, milliseconds since the Unix epoch.
    pub at_ms: Millis,
    /// In which stage, from 1.
    pub stage: usize,
    /// What.
    pub what: What,
    /// Who ordered it; absent where the hub did it by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// The same in words.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub text: String,
    /// Verdict of all gates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// Each gate with its numbers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gates: Vec<GateResult>,
}
