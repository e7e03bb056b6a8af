//! The threshold of a policy in messages: its name and its value.

use crate::version::current_version;
use albireo_core::policy::{ThresholdSpec, short};
use arrayvec::ArrayString;
use serde::{Deserialize, Serialize};
use std::fmt;
use utoipa::ToSchema;

/// The name of a threshold: `u`, `lambda`, `skip_rate`.
pub type ThresholdName = ArrayString<24>;

/// The value of a policy's threshold with the policy's name for it: `{"name": "u", "value": 3e-4}`, or `lambda` under
/// expected-loss. The name prevents mistaking one policy's value for another's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Threshold {
    /// The policy's name for it.
    #[schema(value_type = String)]
    pub name: ThresholdName,
    /// Its value; its range depends on the policy.
    pub value: f64,
}

impl Threshold {
    /// Creates a threshold; a name that is too long is truncated.
    pub fn new(name: &str, value: f64) -> Self {
        let fits = name.floor_char_boundary(ThresholdName::new_const().capacity());
        Self {
            name: name[..fits].parse().unwrap_or_default(),
            value,
        }
    }

    /// Returns the value if it belongs to `spec`.
    ///
    /// # Errors
    /// [`OtherThreshold`] if it has another name.
    pub fn value_of(&self, spec: &ThresholdSpec) -> Result<f64, OtherThreshold> {
        if self.name.as_str() == spec.name {
            Ok(self.value)
        } else {
            Err(OtherThreshold {
                of_policy: spec.name,
                given: self.name,
            })
        }
    }
}

impl fmt::Display for Threshold {
    /// Examples: `u 3e-4`, `lambda 0.3`.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} {}", self.name, short(self.value))
    }
}

/// The error for a threshold whose name is not the policy's.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the threshold of the policy in use is `{of_policy}`, not `{given}`")]
pub struct OtherThreshold {
    of_policy: &'static str,
    given: ThresholdName,
}

/// A change of the threshold during a clip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ThresholdChange {
    /// First frame to which it applies.
    pub seq: u64,
    /// The new value.
    pub threshold: Threshold,
}

/// The threshold of a camera, on its `threshold` key: in a put, in a query's payload and in the reply.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ThresholdMessage {
    /// Version of the message; optional on input.
    #[serde(default = "current_version")]
    pub v: u32,
    /// The threshold.
    pub threshold: Threshold,
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::policy::{Albireo, ExpectedLoss};

    #[test]
    fn the_version_is_optional_and_missing_or_unknown_fields_are_rejected() {
        let read = serde_json::from_str::<ThresholdMessage>;
        let message = read(r#"{"threshold":{"name":"u","value":5e-4}}"#).unwrap();
        assert_eq!(message.v, 1);
        assert_eq!(message.threshold, Threshold::new("u", 5e-4));
        for wrong in [
            r#"{}"#,
            r#"{"v":1}"#,
            r#"{"u":3e-4}"#,
            r#"{"threshold":3e-4}"#,
            r#"{"threshold":{"name":"u"}}"#,
            r#"{"threshold":{"name":"u","value":"small"}}"#,
            r#"{"threshold":{"name":"u","value":1},"u":2}"#,
            r#"[1]"#,
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn new_truncates_a_long_name_and_deserialising_rejects_it() {
        let longest = Threshold::new("component_size", 1.0);
        assert_eq!(longest.name.as_str(), "component_size");
        let name = "x".repeat(25);
        let text = format!(r#"{{"name":"{name}","value":1}}"#);
        assert!(serde_json::from_str::<Threshold>(&text).is_err());
        let long = Threshold::new(&"ä".repeat(20), 1.0);
        assert_eq!(long.name.chars().count(), 12);
    }

    #[test]
    fn a_threshold_of_another_policy_is_rejected_by_name() {
        let threshold = Threshold::new("u", 5e-4);
        assert_eq!(threshold.value_of(&Albireo::THRESHOLD), Ok(5e-4));
        let error = threshold.value_of(&ExpectedLoss::THRESHOLD).unwrap_err();
        let expected = "the threshold of the policy in use is `lambda`, not `u`";
        assert_eq!(error.to_string(), expected);
    }
}
