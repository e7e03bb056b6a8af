//! Keeps the desired setting of each node in memory, for answering pulls.

use crate::store::row::json_text;
use albireo_wire::{Desired, DesiredSetting};
use parking_lot::RwLock;
use serde::Deserialize;
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// The desired setting of a node: a threshold or a target.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct DesiredValue {
    /// The revision of the setting, higher than every earlier one.
    pub revision: u64,
    /// The threshold or the target.
    #[serde(with = "json_text")]
    pub setting: DesiredSetting,
}

/// The desired setting of each node, as in the database, and the nodes that somebody watches.
#[derive(Debug, Default)]
pub struct Desires {
    values: RwLock<HashMap<String, DesiredValue>>,
    watched: RwLock<HashMap<String, Instant>>,
}

impl Desires {
    /// Stores a setting if its revision is higher than the present one. Returns true if it was stored.
    pub(crate) fn set(&self, node: &str, value: DesiredValue) -> bool {
        let mut values = self.values.write();
        let newer = (values.get(node)).is_none_or(|present| present.revision < value.revision);
        if newer {
            values.insert(node.to_owned(), value);
        }
        newer
    }

    /// Drops the desired setting of a node.
    pub(crate) fn remove(&self, node: &str) {
        self.values.write().remove(node);
    }

    /// The desired setting of a node.
    pub(crate) fn get(&self, node: &str) -> Option<DesiredValue> {
        self.values.read().get(node).copied()
    }

    /// All desired settings, by node.
    pub(crate) fn all(&self) -> Vec<(String, DesiredValue)> {
        let values = self.values.read();
        values
            .iter()
            .map(|(node, value)| (node.clone(), *value))
            .collect()
    }

    /// The answer to a pull of `node`.
    pub fn of(&self, node: &str) -> Desired {
        let value = self.get(node);
        let until = self.watched.read().get(node).copied();
        let watched = until
            .map(|until| until.saturating_duration_since(Instant::now()))
            .filter(|left| !left.is_zero());
        Desired {
            revision: value.map_or(0, |value| value.revision),
            setting: value.map(|value| value.setting),
            watched_for_s: watched
                .map(|left| u32::try_from(left.as_secs() + 1).unwrap_or(u32::MAX)),
            ..Desired::nothing()
        }
    }

    /// Marks `node` as watched for `time`, during which it sends counters once per second.
    pub fn watch(&self, node: &str, time: Duration) {
        let now = Instant::now();
        let mut watched = self.watched.write();
        watched.retain(|_, until| *until > now);
        watched.insert(node.to_owned(), now + time);
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
            let values = Desires::default();
            let mut highest = None;
            for revision in revisions {
                let value = revision as f64;
                // A value of the threshold and a target take turns: there is one revision for both.
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
