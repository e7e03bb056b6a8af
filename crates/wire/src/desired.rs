//! What a hub desires of a node. A node pulls it (`{prefix}/@pull/{node}`) after a poke (`{prefix}/@poke/{node}`), when it
//! starts, and finds it in the answer to every batch of reports: so a lost poke costs one period.

use crate::version::VERSION;
use crate::{KnobValue, Target};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Says that there is something to pull.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Poke {
    /// Version.
    pub v: u32,
    /// Generation of what is desired.
    pub generation: u64,
}

/// A node asks what is desired.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct PullRequest {
    /// Version.
    pub v: u32,
    /// Instance of the node.
    pub instance: String,
    /// Generation it has, 0 for none.
    pub generation: u64,
}

/// What is desired of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Desired {
    /// Version.
    pub v: u32,
    /// Number of this desired value; a lower one never replaces a higher. 0 when nothing was ever desired.
    pub generation: u64,
    /// The knob's value; absent when nothing is desired of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<std::collections::BTreeMap<String, f64>>)]
    pub knob: Option<KnobValue>,
    /// What is to be held in the place of the knob's number; absent when nothing is desired of it. Never beside `knob`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<Target>,
    /// Nothing is to be held in the place of the knob's number: what is held is switched off, and the knob stays where it
    /// is. Never beside `knob` or `target`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub hold_nothing: bool,
    /// How much longer somebody watches the node, seconds: so long it sends counters at 1 Hz. Absent when nobody
    /// does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub watched_for_s: Option<u32>,
    /// The hub missed a status: send the full one.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub send_full_status: bool,
    /// The hub reads signs of life in their short form.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub signs_of_life: bool,
    /// The hub reads reports that are compressed against dictionaries up to this number; absent where it reads gzip
    /// alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub report_dictionary: Option<u8>,
}

impl Desired {
    /// Nothing is desired.
    pub const fn nothing() -> Self {
        Self {
            v: VERSION,
            generation: 0,
            knob: None,
            target: None,
            hold_nothing: false,
            watched_for_s: None,
            send_full_status: false,
            signs_of_life: false,
            report_dictionary: None,
        }
    }
}
