//! The choice of a node's policy.

use crate::version::current_version;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The policy in a put, in a query's payload and in the answer to a query: `{"policy": {"name": "expected-loss"}}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyMessage {
    /// Version of the message; optional on input.
    #[serde(default = "current_version")]
    pub v: u32,
    /// The policy.
    pub policy: PolicyChoice,
}

/// A policy by its name, of all cameras: `{"name": "expected-loss"}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyChoice {
    /// Its name, as in `policy.name` of the configuration.
    pub name: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_typed_by_hand_is_read_and_one_with_another_field_is_not() {
        let read = serde_json::from_str::<PolicyMessage>;
        let message = read(r#"{"policy":{"name":"expected-loss"}}"#).unwrap();
        assert_eq!(message.v, 1);
        assert_eq!(message.policy.name, "expected-loss");
        for wrong in [
            r#"{"policy":"expected-loss"}"#,
            r#"{"policy":{"name":"albireo","u":1e-3}}"#,
            "{}",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
