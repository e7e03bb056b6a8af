//! What tuning needs to know of the fleet: each node's labels, its values in force, and whether it is in reach.

use super::members::Seen;
use crate::presence::{self, NodeView, PresenceState};
use albireo_wire::{DesiredSetting, NodeStatus, SettingSource, Target, Threshold, ThresholdName};
use std::collections::BTreeMap;

/// What the hub knows of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeFacts {
    /// Its name.
    pub name: String,
    /// Whether it is in reach: online or degraded.
    pub reachable: bool,
    /// Revision in force that it reported last.
    pub revision: u64,
    /// Its last full status, if it ever sent one.
    pub status: Option<NodeStatus>,
}

/// The nodes, as presence knows them.
pub trait Fleet: Send + Sync {
    /// All nodes.
    fn nodes(&self) -> Vec<NodeFacts>;
    /// One node.
    fn node(&self, name: &str) -> Option<NodeFacts>;
}

impl Fleet for presence::Fleet {
    fn nodes(&self) -> Vec<NodeFacts> {
        let views = self.views();
        views.into_iter().map(NodeFacts::from).collect()
    }

    fn node(&self, name: &str) -> Option<NodeFacts> {
        self.view(name).map(NodeFacts::from)
    }
}

impl From<NodeView> for NodeFacts {
    fn from(view: NodeView) -> Self {
        Self {
            reachable: matches!(view.state, PresenceState::Online | PresenceState::Degraded),
            name: view.node,
            revision: view.revision,
            status: view
                .status
                .and_then(|status| serde_json::from_value(status).ok()),
        }
    }
}

impl NodeFacts {
    /// Its labels.
    pub fn labels(&self) -> BTreeMap<String, String> {
        let labels = self.status.as_ref().map(|status| status.labels.clone());
        labels.unwrap_or_default()
    }

    /// The value in force on all of its cameras; `None` when they differ, have none, or nothing is known.
    pub fn knob(&self) -> Option<Threshold> {
        let cameras = &self.status.as_ref()?.cameras;
        let first = cameras.first()?.threshold;
        first.filter(|_| cameras.iter().all(|camera| camera.threshold == first))
    }

    /// Name of its policy's knob, when a camera tells.
    pub fn knob_name(&self) -> Option<ThresholdName> {
        let status = self.status.as_ref()?;
        status
            .cameras
            .iter()
            .find_map(|camera| camera.threshold)
            .map(|threshold| threshold.name)
    }

    /// What it holds in the place of its knob's number.
    pub fn target(&self) -> Option<Target> {
        Some(self.status.as_ref()?.target?.target)
    }

    /// What it has: its target, or its knob's value where it holds none.
    pub fn setting(&self) -> Option<DesiredSetting> {
        (self
            .target()
            .map(|target| DesiredSetting::Target(Some(target))))
        .or_else(|| self.knob().map(DesiredSetting::Threshold))
    }

    /// Why it holds no target any more, in its own words.
    pub fn target_off(&self) -> Option<String> {
        self.status.as_ref()?.target_off.clone()
    }

    /// Why no target can be ordered of it, as far as its status tells.
    pub fn cannot_hold(&self) -> Option<String> {
        let status = self.status.as_ref()?;
        // Before its cameras have told, the node itself knows.
        let name = self.knob_name()?;
        (!matches!(name.as_str(), "u" | "lambda")).then(|| {
            let policy = &status.policy;
            format!("a target moves `u` or `lambda`, and policy `{policy}` has `{name}`")
        })
    }

    /// Whether somebody at the node has set a value of a camera.
    pub fn set_locally(&self) -> bool {
        let status = self.status.as_ref();
        status.is_some_and(|status| {
            status
                .cameras
                .iter()
                .any(|c| c.threshold_source == SettingSource::Local)
        })
    }

    /// The same for deciding what became of an order.
    pub fn seen(&self) -> Seen {
        let refused = self
            .status
            .as_ref()
            .and_then(|status| status.refused.as_ref());
        Seen {
            reachable: self.reachable,
            revision: self.revision,
            knob: self.knob(),
            target: self.target(),
            cannot_hold: self.cannot_hold(),
            refused: refused.map(|refused| (refused.revision, refused.reason.clone())),
        }
    }
}
