//! What is desired of each node, in memory, as the database has it.

use albireo_wire::DesiredSetting;
use parking_lot::RwLock;
use std::collections::HashMap;

/// What is desired of a node: a value of its knob, or a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DesiredValue {
    /// Its number.
    pub revision: u64,
    /// The value or the target.
    pub setting: DesiredSetting,
}

/// The desired values by node.
#[derive(Debug, Default)]
pub struct DesiredValues(RwLock<HashMap<String, DesiredValue>>);

impl DesiredValues {
    /// Takes a value; one of a lower or the same revision changes nothing. Returns whether it was taken.
    pub fn set(&self, node: &str, value: DesiredValue) -> bool {
        let mut values = self.0.write();
        match values.get_mut(node) {
            Some(present) if present.revision >= value.revision => false,
            Some(present) => {
                *present = value;
                true
            }
            None => {
                values.insert(node.to_owned(), value);
                true
            }
        }
    }

    /// Drops what is desired of a node.
    pub(crate) fn remove(&self, node: &str) {
        self.0.write().remove(node);
    }

    /// The value desired of a node.
    pub fn get(&self, node: &str) -> Option<DesiredValue> {
        self.0.read().get(node).copied()
    }

    /// All of them.
    pub fn all(&self) -> Vec<(String, DesiredValue)> {
        let values = self.0.read();
        values
            .iter()
            .map(|(node, value)| (node.clone(), *value))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_wire::{Target, Threshold};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_lower_revision_never_replaces_a_higher(revisions in prop::collection::vec(0u64..20, 1..30)) {
            let values = DesiredValues::default();
            let mut highest = None;
            for revision in revisions {
                let value = revision as f64;
                // A value of the knob and a target take turns: there is one revision for both.
                let setting = match revision % 2 {
                    0 => DesiredSetting::Threshold(Threshold::new("u", value)),
                    _ => DesiredSetting::Target(Some(Target::Watts(value))),
                };
                let taken = values.set("n", DesiredValue { revision, setting });
                prop_assert_eq!(taken, highest.is_none_or(|highest| revision > highest));
                highest = highest.max(Some(revision));
                prop_assert_eq!(values.get("n").map(|v| v.revision), highest);
            }
            prop_assert_eq!(values.get("other"), None);
        }
    }
}
