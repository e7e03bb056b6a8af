//! Defines the record of a rollout or trial, and what an answer adds to it.

use super::super::gate::{GateResult, Verdict};
use super::super::member::Millis;
use super::super::outcome::Outcome;
use crate::named::named;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use std::collections::BTreeMap;
use utoipa::ToSchema;

named! {
    /// The kind of an entry.
    pub enum What {
        /// It began.
        Begun = "begun",
        /// A stage began.
        Stage = "stage",
        /// The nodes have the value.
        Soaking = "soaking",
        /// The gates were judged.
        Judged = "judged",
        /// It waits for a person to decide.
        Held = "held",
        /// Nodes were out of reach for too long.
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
        /// Somebody began the next stage.
        Next = "next",
        /// Somebody began the return.
        Return = "return",
        /// Somebody ended it.
        Stopped = "stopped",
    }
}

/// An entry of the record.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Entry {
    /// When, milliseconds since the Unix epoch.
    pub at_ms: Millis,
    /// The stage, from 1.
    pub stage: usize,
    /// Its kind.
    pub what: What,
    /// Who commanded it; absent if the hub did it by itself.
    pub who: Option<String>,
    /// Details, as text.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub text: String,
    /// The verdict of all gates together.
    pub verdict: Option<Verdict>,
    /// Each gate with its numbers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gates: Vec<GateResult>,
}

/// A stage of a rollout, or a group of a trial.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StageView {
    /// The number of nodes that it adds.
    pub nodes: usize,
    /// The number of them by outcome.
    pub counts: BTreeMap<Outcome, usize>,
}

/// A node that was selected and takes no part, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LeftOut {
    /// The node.
    pub node: String,
    /// The reason.
    pub why: String,
}
