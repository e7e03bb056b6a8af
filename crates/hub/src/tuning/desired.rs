//! Keeps the desired setting of each node in memory, for answering pulls, and what became of it at the node. Notifies nodes
//! that they should pull.

use super::member::Millis;
use super::outcome::{Given, Outcome};
use albireo_wire::{Desired, DesiredSetting};
use parking_lot::RwLock;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};
use utoipa::ToSchema;

/// The desired setting of a node, and what became of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NodeSetting {
    /// The node.
    pub node: String,
    /// The setting: a threshold, or a target (null switches it off).
    #[serde(rename = "to")]
    pub setting: DesiredSetting,
    /// The setting that the node had before, if known.
    pub from: Option<DesiredSetting>,
    /// Its revision, and what became of it.
    #[serde(flatten)]
    pub given: Given,
    /// How often the node was set back since a person gave it a setting, as far as this hub knows.
    #[serde(skip)]
    pub(crate) set_back: u32,
    /// When the hub noticed that the node drifted; absent unless it has.
    #[serde(skip)]
    pub(crate) drifted_ms: Option<Millis>,
}

impl NodeSetting {
    /// One that a person gives, with its outcome at `now`; it has no revision yet.
    pub(crate) const fn new(
        node: String,
        setting: DesiredSetting,
        from: Option<DesiredSetting>,
        outcome: Outcome,
        now: Millis,
    ) -> Self {
        Self {
            node,
            setting,
            from,
            given: Given::new(0, now, outcome),
            set_back: 0,
            drifted_ms: None,
        }
    }
}

/// Says that a node may pull its desired setting.
#[derive(Debug)]
pub struct Notice {
    /// The node.
    pub node: String,
    /// The revision that it may pull.
    pub revision: u64,
}

/// Most notices that may wait. Further ones are dropped: later notices, and the answers to reports, have the same
/// effect.
const NOTICES: usize = 65_536;

/// The desired setting of each node, as in the database, and the nodes that somebody watches.
#[derive(Debug)]
pub struct DesiredSettings {
    nodes: RwLock<BTreeMap<String, NodeSetting>>,
    watched: RwLock<HashMap<String, Instant>>,
    notifier: SyncSender<Notice>,
}

impl DesiredSettings {
    /// Creates it without a desired setting. Also returns the notices to send.
    pub fn new() -> (Self, Receiver<Notice>) {
        let (notifier, notices) = sync_channel(NOTICES);
        let desired = Self {
            nodes: RwLock::default(),
            watched: RwLock::default(),
            notifier,
        };
        (desired, notices)
    }

    /// Replaces the desired setting of a node by one with a higher revision.
    pub(crate) fn set(&self, desired: NodeSetting) {
        replace(&mut self.nodes.write(), desired);
    }

    /// Does the same as [`set`](Self::set), and the node stays listed as drifted until it has its setting again.
    pub(crate) fn set_keeping_drift(&self, mut desired: NodeSetting) {
        let mut nodes = self.nodes.write();
        if let Some(present) = nodes.get(&desired.node) {
            desired.set_back += present.set_back;
            desired.drifted_ms = present.drifted_ms;
        }
        replace(&mut nodes, desired);
    }

    /// Stores what became of a setting, unless another one replaced it meanwhile.
    pub(crate) fn update(&self, desired: NodeSetting) {
        if let Some(present) = self.nodes.write().get_mut(&desired.node)
            && present.given.revision == desired.given.revision
        {
            *present = desired;
        }
    }

    /// Drops the desired setting of a node.
    pub(crate) fn remove(&self, node: &str) {
        self.nodes.write().remove(node);
    }

    /// The desired setting of a node.
    pub(crate) fn get(&self, node: &str) -> Option<NodeSetting> {
        self.nodes.read().get(node).cloned()
    }

    /// The desired settings for which `is_one` is true, in the order of the nodes' names.
    pub(crate) fn list(&self, is_one: impl Fn(&NodeSetting) -> bool) -> Vec<NodeSetting> {
        let nodes = self.nodes.read();
        nodes.values().filter(|one| is_one(one)).cloned().collect()
    }

    /// The answer to a pull of `node`.
    pub fn of(&self, node: &str) -> Desired {
        let until = self.watched.read().get(node).copied();
        let left = until.and_then(|until| until.checked_duration_since(Instant::now()));
        let nodes = self.nodes.read();
        let desired = nodes.get(node);
        Desired {
            revision: desired.map_or(0, |desired| desired.given.revision),
            setting: desired.map(|desired| desired.setting),
            watched_for_s: left.map(|left| u32::try_from(left.as_secs() + 1).unwrap_or(u32::MAX)),
            ..Desired::nothing()
        }
    }

    /// Notifies `node` that it should pull. If too many notices wait, drops it.
    pub(crate) fn notify(&self, node: &str) {
        let _ = self.notifier.try_send(Notice {
            node: node.to_owned(),
            revision: self.of(node).revision,
        });
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

fn replace(nodes: &mut BTreeMap<String, NodeSetting>, desired: NodeSetting) {
    if let Some(present) = nodes.get(&desired.node)
        && present.given.revision >= desired.given.revision
    {
        return;
    }
    nodes.insert(desired.node.clone(), desired);
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_wire::{Target, Threshold};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_lower_revision_never_replaces_a_higher(revisions in prop::collection::vec(0u64..20, 1..30)) {
            let (settings, _notices) = DesiredSettings::new();
            let mut highest: Option<NodeSetting> = None;
            for revision in revisions {
                let value = revision as f64;
                // Thresholds and targets take turns: they have one series of revisions.
                let setting = if revision.is_multiple_of(2) {
                    DesiredSetting::Threshold(Threshold::new("u", value))
                } else {
                    DesiredSetting::Target(Some(Target::Watts(value)))
                };
                let mut desired =
                    NodeSetting::new("n".to_owned(), setting, None, Outcome::Pending, 0);
                desired.given.revision = revision;
                settings.set(desired.clone());
                match &highest {
                    Some(before) if before.given.revision >= revision => {}
                    _ => highest = Some(desired),
                }
                prop_assert_eq!(settings.get("n"), highest.clone());
            }
            prop_assert_eq!(settings.of("other"), Desired::nothing());
        }
    }
}
