//! The desired setting of a node. A node queries it (`{prefix}/@pull/{node}`) at start and after a notice
//! (`{prefix}/@changed/{node}`), and receives it in the answer to every report batch: a lost notice costs one period.

use crate::version::VERSION;
use crate::{Target, Threshold};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// The desired setting of a node: a threshold or a target. A node has only one, so each kind replaces the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DesiredSetting {
    /// A threshold: `{"threshold": {"name": "u", "value": 3e-4}}`. It switches a target off.
    Threshold(Threshold),
    /// A target: `{"target": {"skip_rate": 0.5}}`; `{"target": null}` switches it off and keeps the threshold.
    Target(Option<Target>),
}

/// The revision of a desired setting: in a notice the one that the node may pull, in a pull the one that it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RevisionMessage {
    /// Version of the message.
    pub v: u32,
    /// The revision; 0 for none.
    pub revision: u64,
}

/// The answer with a node's desired setting.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Desired {
    /// Version of the message.
    pub v: u32,
    /// Revision of the desired setting; a lower one never replaces a higher one. 0 if there has never been one.
    pub revision: u64,
    /// The setting; absent if none is desired.
    pub setting: Option<DesiredSetting>,
    /// Remaining time for which the node is watched, seconds: until then it sends counters once per second. Absent if
    /// it is not watched.
    pub watched_for_s: Option<u32>,
    /// Time between two heartbeats of the node, seconds, which is longer in a large fleet; 30 if it is absent.
    pub heartbeat_s: Option<u32>,
    /// True if the hub missed a status and the node must send the full one.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub send_full_status: bool,
}

impl Desired {
    /// Returns an answer without a desired setting.
    pub const fn nothing() -> Self {
        Self {
            v: VERSION,
            revision: 0,
            setting: None,
            watched_for_s: None,
            heartbeat_s: None,
            send_full_status: false,
        }
    }
}
