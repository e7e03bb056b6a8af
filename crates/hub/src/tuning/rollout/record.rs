//! The record of a rollout: its events with their numbers.

use super::super::gate::{GateResult, Verdict};
use super::super::members::Millis;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What kind of thing happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// It was begun.
    Begun,
    /// A stage was entered.
    Stage,
    /// A stage's nodes have the value.
    Soaking,
    /// The gates were judged.
    Judged,
    /// It is held.
    Held,
    /// Nodes stayed away too long.
    Missed,
    /// The old value returns.
    Returning,
    /// The old value is back.
    Returned,
    /// All stages have passed.
    Done,
    /// Somebody paused it.
    Paused,
    /// Somebody resumed it.
    Resumed,
    /// Somebody ordered the next stage.
    Next,
    /// Somebody ordered the return.
    Return,
    /// Somebody ended it.
    Stopped,
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

impl Entry {
    pub(super) fn new(what: What) -> Self {
        Self {
            at_ms: 0,
            stage: 0,
            what,
            who: None,
            text: String::new(),
            verdict: None,
            gates: Vec::new(),
        }
    }

    pub(super) fn by(who: &str, what: What) -> Self {
        Self {
            who: Some(who.to_owned()),
            ..Self::new(what)
        }
    }

    pub(super) fn with(mut self, text: String) -> Self {
        self.text = text;
        self
    }

    pub(super) fn with_gates(mut self, verdict: Verdict, gates: Vec<GateResult>) -> Self {
        self.verdict = Some(verdict);
        self.gates = gates;
        self
    }
}
