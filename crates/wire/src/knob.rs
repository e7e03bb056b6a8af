//! The value of a policy's knob in messages: one field, under the name that the policy declares for it.
//!
//! Albireo's reads `"u": 3e-4`, that of expected-loss `"lambda": 0.3`. So nobody takes one policy's value
//! for another's, and a message says what was turned.

use crate::version::current_version;
use albireo_core::policy::{KNOB_NAMES, Knob, short};
use serde::de::{self, Deserializer, MapAccess, Visitor};
use serde::ser::{SerializeMap, Serializer};
use serde::{Deserialize, Serialize};
use std::fmt;
use utoipa::ToSchema;

/// The value of a knob and its name; an object with that one field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnobValue {
    /// The knob's name: one of [`KNOB_NAMES`].
    pub name: &'static str,
    /// The value.
    pub value: f64,
}

impl KnobValue {
    /// `value` of `knob`.
    pub const fn new(knob: &Knob, value: f64) -> Self {
        Self {
            name: knob.name,
            value,
        }
    }
}

impl fmt::Display for KnobValue {
    /// `u 3e-4`, `lambda 0.3`.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} {}", self.name, short(self.value))
    }
}

impl Serialize for KnobValue {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(1))?;
        map.serialize_entry(self.name, &self.value)?;
        map.end()
    }
}

impl<'de> Deserialize<'de> for KnobValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        optional(deserializer)?.ok_or_else(|| de::Error::invalid_length(0, &AtMostOneKnob))
    }
}

/// Reads a message's knob where it may have none. An `Option` alone would take a value that cannot be read, or two
/// knobs, for none.
pub(crate) fn optional<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<KnobValue>, D::Error> {
    // A struct, so that within another message only the fields of these names are looked at.
    deserializer.deserialize_struct("KnobValue", KNOB_NAMES, AtMostOneKnob)
}

struct AtMostOneKnob;

impl<'de> Visitor<'de> for AtMostOneKnob {
    type Value = Option<KnobValue>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "the value of a knob: {}", KNOB_NAMES.join(", "))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut found = None;
        while let Some(key) = map.next_key::<String>()? {
            match known(&key) {
                Some(name) if found.is_none() => {
                    let value = map.next_value()?;
                    found = Some(KnobValue { name, value });
                }
                Some(_) => return Err(de::Error::custom("more than one knob")),
                None => {
                    map.next_value::<de::IgnoredAny>()?;
                }
            }
        }
        Ok(found)
    }
}

fn known(name: &str) -> Option<&'static str> {
    KNOB_NAMES.iter().copied().find(|known| *known == name)
}

/// A change of the knob during a clip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct KnobChange {
    /// First frame it held for.
    pub seq: u64,
    /// The value, under the knob's name.
    #[serde(flatten)]
    #[schema(value_type = std::collections::BTreeMap<String, f64>)]
    pub knob: KnobValue,
}

/// The threshold, in a put, in a query's payload and in its reply: `{"u": 3e-4}`, or the policy's own
/// knob under its own name.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct ThresholdMessage {
    /// Version; may be left out on the way in.
    pub v: u32,
    /// The value, under the knob's name.
    #[serde(flatten)]
    #[schema(value_type = std::collections::BTreeMap<String, f64>)]
    pub knob: KnobValue,
}

impl<'de> Deserialize<'de> for ThresholdMessage {
    /// Reads an object of one knob and perhaps `v`; anything else beside them is refused.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct OneThreshold;
        impl<'de> Visitor<'de> for OneThreshold {
            type Value = ThresholdMessage;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("an object with the value of a knob")
            }

            fn visit_map<A: MapAccess<'de>>(
                self,
                mut map: A,
            ) -> Result<ThresholdMessage, A::Error> {
                let (mut v, mut knob) = (None, None);
                while let Some(key) = map.next_key::<String>()? {
                    if key == "v" {
                        if v.replace(map.next_value()?).is_some() {
                            return Err(de::Error::duplicate_field("v"));
                        }
                    } else if let Some(name) = known(&key) {
                        let value = map.next_value()?;
                        if let Some(KnobValue { name: first, .. }) =
                            knob.replace(KnobValue { name, value })
                        {
                            return Err(de::Error::custom(format_args!(
                                "both `{first}` and `{name}`: one value at a time"
                            )));
                        }
                    } else {
                        return Err(de::Error::unknown_field(&key, KNOB_NAMES));
                    }
                }
                Ok(ThresholdMessage {
                    v: v.unwrap_or(current_version()),
                    knob: knob.ok_or_else(|| de::Error::custom("no value"))?,
                })
            }
        }
        deserializer.deserialize_map(OneThreshold)
    }
}

/// A value for a knob of another name than the policy's.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("the policy in use is turned by `{wanted}`, not by `{sent}`")]
pub struct WrongKnob {
    /// The policy's knob.
    pub wanted: &'static str,
    /// The one that was sent.
    pub sent: &'static str,
}

impl ThresholdMessage {
    /// The value for `knob`.
    ///
    /// # Errors
    /// [`WrongKnob`] when the message is about one of another name.
    pub fn value_of(&self, knob: &Knob) -> Result<f64, WrongKnob> {
        if self.knob.name == knob.name {
            Ok(self.knob.value)
        } else {
            Err(WrongKnob {
                wanted: knob.name,
                sent: self.knob.name,
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::policy::{Albireo, ExpectedLoss};

    #[test]
    fn a_knob_stands_under_its_own_name() {
        let change = KnobChange {
            seq: 7,
            knob: KnobValue::new(&ExpectedLoss::KNOB, 0.8),
        };
        let text = serde_json::to_string(&change).unwrap();
        assert_eq!(text, r#"{"seq":7,"lambda":0.8}"#);
        assert_eq!(serde_json::from_str::<KnobChange>(&text).unwrap(), change);
    }

    #[test]
    fn a_message_may_leave_the_version_out_and_nothing_else_may_be_in() {
        let read = serde_json::from_str::<ThresholdMessage>;
        let message = read(r#"{"u":5e-4}"#).unwrap();
        assert_eq!((message.v, message.knob.value), (1, 5e-4));
        for wrong in [
            r#"{}"#,
            r#"{"v":1}"#,
            r#"{"u":"small"}"#,
            r#"{"u":1,"lambda":1}"#,
            r#"{"u":1,"u":2}"#,
            r#"{"u":1,"x":2}"#,
            r#"[1]"#,
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_value_for_another_policys_knob_is_refused_by_name() {
        let message: ThresholdMessage = serde_json::from_str(r#"{"u":5e-4}"#).unwrap();
        assert_eq!(message.value_of(&Albireo::KNOB), Ok(5e-4));
        let error = message.value_of(&ExpectedLoss::KNOB).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the policy in use is turned by `lambda`, not by `u`"
        );
    }
}
