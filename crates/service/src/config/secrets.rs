//! Removes secrets from a configuration before it is shown.

use serde::Serialize;
use serde_json::Value;

/// Shown instead of a secret.
pub const MASK: &str = "(secret)";

/// The configuration with every secret masked: the value of each member named `token`, `password` or `secret`.
pub fn without_secrets(config: &impl Serialize) -> Value {
    let mut shown = serde_json::to_value(config).unwrap_or(Value::Null);
    mask(&mut shown);
    shown
}

fn mask(value: &mut Value) {
    match value {
        Value::Object(members) => {
            for (name, value) in members {
                let is_secret = ["token", "password", "secret"].contains(&name.as_str());
                if is_secret && value.is_string() {
                    *value = MASK.into();
                } else {
                    mask(value);
                }
            }
        }
        Value::Array(values) => {
            for value in values {
                mask(value);
            }
        }
        _ => {}
    }
}
