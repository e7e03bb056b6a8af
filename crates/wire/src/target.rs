//! The target of a node and its state.

use crate::version::current_version;
use crate::{SettingSource, Threshold};
use albireo_core::target::{Target, TargetState, TargetStatus, ThresholdRange};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// A target in a put, in a query's payload and in a request: `{"target": {"skip_rate": 0.5}}`, or `{"target": null}`
/// for none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TargetMessage {
    /// Version of the message; optional on input.
    #[serde(default = "current_version")]
    pub v: u32,
    /// The target; null for none, which keeps the threshold.
    // It may be null but must be present.
    #[serde(deserialize_with = "Option::deserialize")]
    pub target: Option<Target>,
}

/// The target of a node and its state.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TargetReport {
    /// Version of the message.
    pub v: u32,
    /// The target; null for none.
    #[serialize_always]
    pub target: Option<Target>,
    /// Origin of the target or of its removal.
    pub source: SettingSource,
    /// Human-readable reason why there is no target any more.
    pub off: Option<String>,
    /// The range within which the threshold moves; absent without a target.
    pub range: Option<ThresholdRange>,
    /// The threshold in force; absent without a target.
    pub threshold: Option<Threshold>,
    /// The measured value and the reason for the threshold; absent without a target and before the first second.
    pub state: Option<TargetState>,
    /// The state, human-readable.
    pub why: Option<String>,
}

/// The target in a node's status, without the figures that change constantly.
#[skip_serializing_none]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NodeTarget {
    /// The target.
    pub target: Target,
    /// Origin of the target.
    pub source: SettingSource,
    /// The reason for the threshold's value; absent before the first second.
    pub status: Option<TargetStatus>,
    /// The measured value when the status was created.
    pub actual: Option<f64>,
}

impl TargetReport {
    /// Returns the target for the status; `None` without a target.
    pub fn status(&self) -> Option<NodeTarget> {
        let target = self.target?;
        Some(NodeTarget {
            target,
            source: self.source,
            status: self.state.map(|state| state.status),
            actual: self.state.and_then(|state| state.actual),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_message_holds_one_known_target_or_null() {
        let read = serde_json::from_str::<TargetMessage>;
        let message = read(r#"{"target":{"skip_rate":0.5}}"#).unwrap();
        assert_eq!(message.v, 1);
        assert_eq!(message.target, Some(Target::SkipRate(0.5)));
        assert_eq!(read(r#"{"target":null,"v":1}"#).unwrap().target, None);
        for wrong in [
            "{}",
            r#"{"target":0.5}"#,
            r#"{"target":{"speed":1}}"#,
            r#"{"target":{"skip_rate":0.5,"watts":3}}"#,
            r#"{"target":{"skip_rate":"half"}}"#,
            r#"{"target":null,"u":3}"#,
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
