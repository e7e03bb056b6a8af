//! What a node is answered when it asks what is desired: from memory.

use crate::tuning::desired::DesiredValues;
use albireo_wire::Desired;
use parking_lot::RwLock;
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// What is desired of each node, and which of them somebody watches.
#[derive(Debug, Default)]
pub struct Desires {
    /// The desired values.
    pub values: DesiredValues,
    watched: RwLock<HashMap<String, Instant>>,
}

impl Desires {
    /// What is desired of `node`.
    pub fn of(&self, node: &str) -> Desired {
        let value = self.values.get(node);
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

    /// Somebody watches `node` for so long: it then sends counters once a second.
    pub fn watch(&self, node: &str, time: Duration) {
        let now = Instant::now();
        let mut watched = self.watched.write();
        watched.retain(|_, until| *until > now);
        watched.insert(node.to_owned(), now + time);
    }
}
