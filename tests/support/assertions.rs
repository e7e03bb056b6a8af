//! Assertions about texts and JSON values.

use serde_json::Value;
use std::fmt::Display;

#[track_caller]
pub(crate) fn assert_contains(said: &(impl Display + ?Sized), parts: &[&str]) {
    let said = said.to_string();
    for part in parts {
        assert!(said.contains(part), "no `{part}` in: {said}");
    }
}

/// Asserts that `found` contains `expected`: its objects may have more members.
#[track_caller]
pub(crate) fn assert_has(found: &Value, expected: &Value) {
    fn has(found: &Value, expected: &Value) -> bool {
        match (found, expected) {
            (_, Value::Object(members)) => {
                members.iter().all(|(name, wanted)| has(&found[name], wanted))
            }
            (Value::Array(found), Value::Array(expected)) => {
                found.len() == expected.len()
                    && found.iter().zip(expected).all(|(one, wanted)| has(one, wanted))
            }
            _ => found == expected,
        }
    }
    assert!(has(found, expected), "no {expected} in {found}");
}
