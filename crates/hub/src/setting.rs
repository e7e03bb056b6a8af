//! What can be ordered of a node: a value of its knob, or what it is to hold in the value's place. A node has one
//! desired setting with one generation, so that each replaces the other.

use albireo_wire::{KnobValue, Target};
use serde::ser::{Serialize, SerializeMap, Serializer};
use std::fmt;

/// What is ordered of a node, or what it has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Setting {
    /// A value of its knob. Whatever it held in the value's place is over.
    Knob(KnobValue),
    /// A target.
    Hold(Target),
    /// Nothing is held, and the knob stays where it is.
    HoldNothing,
}

impl From<KnobValue> for Setting {
    fn from(knob: KnobValue) -> Self {
        Self::Knob(knob)
    }
}

impl fmt::Display for Setting {
    /// `u 3e-4`, `target skip_rate 0.5`, `no target`.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Knob(knob) => knob.fmt(formatter),
            Self::Hold(target) => write!(formatter, "target {target}"),
            Self::HoldNothing => formatter.write_str("no target"),
        }
    }
}

impl Serialize for Setting {
    /// `{"u": 3e-4}`, `{"target": {"skip_rate": 0.5}}`, `{"target": null}`: as it is ordered.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let target = match self {
            Self::Knob(knob) => return knob.serialize(serializer),
            Self::Hold(target) => Some(target),
            Self::HoldNothing => None,
        };
        let mut map = serializer.serialize_map(Some(1))?;
        map.serialize_entry("target", &target)?;
        map.end()
    }
}

impl Setting {
    /// Whether a node with that value of its knob and that target has it. A value that a target has moved to is on its way
    /// elsewhere, and is not had.
    pub(crate) fn is_had(self, knob: Option<KnobValue>, target: Option<Target>) -> bool {
        match self {
            Self::Knob(wanted) => knob == Some(wanted) && target.is_none(),
            Self::Hold(wanted) => target == Some(wanted),
            Self::HoldNothing => target.is_none(),
        }
    }

    /// The same number of another knob's name never stands for it: equal settings have equal texts, and no others.
    pub(crate) fn key(self) -> String {
        match self {
            Self::Knob(knob) => format!("{}={}", knob.name, knob.value),
            Self::Hold(target) => format!("target {}", target_text(target)),
            Self::HoldNothing => format!("target {OFF}"),
        }
    }
}

/// What stands in the column `target` where nothing is to be held.
pub(crate) const OFF: &str = "off";

/// A target as it is kept: `skip_rate=0.5`, the number in the shortest text that reads back as the same.
pub(crate) fn target_text(target: Target) -> String {
    format!("{}={}", target.name(), target.value())
}

/// Reads what [`target_text`] wrote.
pub(crate) fn target_of(text: &str) -> Option<Target> {
    let (name, value) = text.split_once('=')?;
    Target::named(name, value.parse().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_setting_is_told_as_it_is_ordered() {
        let told = |setting: Setting| serde_json::to_string(&setting).unwrap();
        let knob = KnobValue {
            name: "skip_rate",
            value: 0.5,
        };
        assert_eq!(told(knob.into()), r#"{"skip_rate":0.5}"#);
        let target = Setting::Hold(Target::SkipRate(0.5));
        assert_eq!(told(target), r#"{"target":{"skip_rate":0.5}}"#);
        assert_eq!(told(Setting::HoldNothing), r#"{"target":null}"#);
        assert_ne!(Setting::from(knob).key(), target.key());
    }

    proptest! {
        #[test]
        fn a_kept_target_reads_back_as_the_same(value in prop::num::f64::NORMAL, which in 0..Target::NAMES.len()) {
            let target = Target::named(Target::NAMES[which], value).unwrap();
            prop_assert_eq!(target_of(&target_text(target)), Some(target));
        }
    }

    #[test]
    fn what_is_no_target_is_not_read_as_one() {
        for text in ["", OFF, "skip_rate", "skip_rate=", "speed=1"] {
            assert_eq!(target_of(text), None, "{text}");
        }
    }
}
