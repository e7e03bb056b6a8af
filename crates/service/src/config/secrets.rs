//! Removes secrets from a configuration before it is shown.

use super::endpoint::with_shown_endpoints;
use serde::Serialize;
use serde_json::Value;

/// Shown instead of a secret.
pub const MASK: &str = "(secret)";

/// The configuration with every secret masked: the value of each member named `token`, `password` or `secret`, and what
/// follows the address of an endpoint.
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
        Value::String(text) => *text = with_shown_endpoints(text),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn neither_a_token_nor_the_key_in_an_endpoint_is_shown() {
        let config = json!({
            "http": { "token": "s3cret" },
            "uplink": { "connect": ["tls/hub:1#connect_private_key_base64=s3cret"] },
        });
        let expected = json!({
            "http": { "token": MASK },
            "uplink": { "connect": ["tls/hub:1"] },
        });
        assert_eq!(without_secrets(&config), expected);
    }
}
