//! Keeps the desired setting of each node in memory, for answering pulls, and what became of it at the node. Notifies nodes
//! that they should pull.

use super::member::{ChangeNode, Millis};
use crate::store::row::json_text;
use albireo_wire::{Desired, DesiredSetting};
use parking_lot::RwLock;
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// The desired setting of a node: a threshold or a target.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Wanted {
    #[serde(with = "json_text")]
    pub(crate) setting: DesiredSetting,
    /// The order that gave it: the node, the revision and the outcome.
    #[serde(flatten)]
    pub(crate) at: ChangeNode,
    /// How often the node was set back since the last order by somebody else, as far as this hub knows.
    #[serde(skip)]
    pub(crate) set_back: u32,
    /// When the hub noticed that the node drifted; absent unless it has.
    #[serde(skip)]
    pub(crate) drifted_ms: Option<Millis>,
}

/// Most notices that may wait. Further ones are dropped: later notices, and the answers to reports, have the same
/// effect.
const NOTICES: usize = 65_536;

/// The desired setting of each node, as in the database, and the nodes that somebody watches.
#[derive(Debug)]
pub struct Desires {
    nodes: RwLock<BTreeMap<String, Wanted>>,
    watched: RwLock<HashMap<String, Instant>>,
    /// Queues notices: a node, and the revision that it may pull.
    notifier: SyncSender<(String, u64)>,
}

impl Desires {
    /// Creates it without a desired setting. Also returns the notices to send.
    pub fn new() -> (Self, Receiver<(String, u64)>) {
        let (notifier, notices) = sync_channel(NOTICES);
        let desires = Self {
            nodes: RwLock::default(),
            watched: RwLock::default(),
            notifier,
        };
        (desires, notices)
    }

    /// Replaces the desired setting of a node by one with a higher revision. With `keeps_drift` the node stays listed as
    /// drifted until it has its setting again.
    pub(crate) fn set(&self, mut wanted: Wanted, keeps_drift: bool) {
        let mut nodes = self.nodes.write();
        if let Some(present) = nodes.get(&wanted.at.node) {
            if present.at.ask.revision >= wanted.at.ask.revision {
                return;
            }
            if keeps_drift {
                wanted.set_back += present.set_back;
                wanted.drifted_ms = present.drifted_ms;
            }
        }
        nodes.insert(wanted.at.node.clone(), wanted);
    }

    /// Stores what became of a setting, unless another one replaced it meanwhile.
    pub(crate) fn update(&self, wanted: Wanted) {
        if let Some(present) = self.nodes.write().get_mut(&wanted.at.node)
            && present.at.ask.revision == wanted.at.ask.revision
        {
            *present = wanted;
        }
    }

    /// Drops the desired setting of a node.
    pub(crate) fn remove(&self, node: &str) {
        self.nodes.write().remove(node);
    }

    /// The desired setting of a node.
    pub(crate) fn get(&self, node: &str) -> Option<Wanted> {
        self.nodes.read().get(node).cloned()
    }

    /// The desired settings for which `is_one` is true, in the order of the nodes' names.
    pub(crate) fn list(&self, is_one: impl Fn(&Wanted) -> bool) -> Vec<Wanted> {
        let nodes = self.nodes.read();
        nodes.values().filter(|one| is_one(one)).cloned().collect()
    }

    /// The answer to a pull of `node`.
    pub fn of(&self, node: &str) -> Desired {
        let until = self.watched.read().get(node).copied();
        let left = until.and_then(|until| until.checked_duration_since(Instant::now()));
        let nodes = self.nodes.read();
        let wanted = nodes.get(node);
        Desired {
            revision: wanted.map_or(0, |wanted| wanted.at.ask.revision),
            setting: wanted.map(|wanted| wanted.setting),
            watched_for_s: left.map(|left| u32::try_from(left.as_secs() + 1).unwrap_or(u32::MAX)),
            ..Desired::nothing()
        }
    }

    /// Notifies `node` that it should pull. If too many notices wait, drops it.
    pub(crate) fn notify(&self, node: &str) {
        let notice = (node.to_owned(), self.of(node).revision);
        let _ = self.notifier.try_send(notice);
    }

    /// Marks `node` as watched for `time`, during which it sends counters once per second, and notifies it.
    pub(crate) fn watch(&self, node: &str, time: Duration) {
        let now = Instant::now();
        let mut watched = self.watched.write();
        watched.retain(|_, until| *until > now);
        watched.insert(node.to_owned(), now + time);
        drop(watched);
        self.notify(node);
    }
}

#[cfg(test)]
mod tests {
    use super::super::member::{Ask, Outcome};
    use super::*;
    use albireo_wire::{Target, Threshold};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_lower_revision_never_replaces_a_higher(revisions in prop::collection::vec(0u64..20, 1..30)) {
            let (values, _notices) = Desires::new();
            let mut highest = None;
            for revision in revisions {
                let value = revision as f64;
                // A value of the threshold and a target take turns: there is one revision for both.
                let setting = match revision % 2 {
                    0 => DesiredSetting::Threshold(Threshold::new("u", value)),
                    _ => DesiredSetting::Target(Some(Target::Watts(value))),
                };
                let at = ChangeNode {
                    node: "n".to_owned(),
                    from: None,
                    ask: Ask::new(revision, 0, Outcome::Pending),
                };
                let wanted = Wanted { setting, at, set_back: 0, drifted_ms: None };
                values.set(wanted, false);
                if highest.is_none_or(|(highest, _)| revision > highest) {
                    highest = Some((revision, setting));
                }
                let found = values.get("n").map(|found| (found.at.ask.revision, found.setting));
                prop_assert_eq!(found, highest);
            }
            prop_assert_eq!(values.of("other"), Desired::nothing());
        }
    }
}
