//! What tuning needs to know of the fleet: each node's labels, its values in force, and whether it is in reach.

use super::members::Seen;
use crate::presence::{self, NodeView, PresenceState};
use crate::setting::Setting;
use albireo_wire::{KnobSource, KnobValue, NodeStatus, Target, TargetError};
use std::collections::BTreeMap;

/// What the hub knows of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeFacts {
    /// Its name.
    pub name: String,
    /// Whether it is in reach: online or degraded.
    pub reachable: bool,
    /// Generation in force that it reported last.
    pub generation: u64,
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
        let views = self.list(None, usize::MAX, |_, _| true);
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
            generation: view.generation,
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
    pub fn knob(&self) -> Option<KnobValue> {
        let cameras = &self.status.as_ref()?.cameras;
        let first = cameras.first()?.knob;
        first.filter(|_| cameras.iter().all(|camera| camera.knob == first))
    }

    /// Name of its policy's knob, when a camera tells.
    pub fn knob_name(&self) -> Option<&'static str> {
        let status = self.status.as_ref()?;
        status
            .cameras
            .iter()
            .find_map(|camera| camera.knob)
            .map(|knob| knob.name)
    }

    /// What it holds in the place of its knob's number.
    pub fn target(&self) -> Option<Target> {
        Some(self.status.as_ref()?.target?.target)
    }

    /// What it has: its target, or its knob's value where it holds none.
    pub fn setting(&self) -> Option<Setting> {
        (self.target().map(Setting::Hold)).or_else(|| self.knob().map(Setting::Knob))
    }

    /// Why it holds no target any more, in its own words.
    pub fn target_off(&self) -> Option<String> {
        self.status.as_ref()?.target_off.clone()
    }

    /// Why no target can be ordered of it, as far as its status tells.
    pub fn cannot_hold(&self) -> Option<String> {
        let status = self.status.as_ref()?;
        if !status.takes_targets {
            return Some(format!(
                "its program, version {}, takes no target from a hub: it has to be brought up to date first",
                status.version
            ));
        }
        match self.knob_name() {
            // Before its cameras have told, the node itself knows.
            None | Some("u" | "lambda") => None,
            knob => Some(
                TargetError::Policy {
                    policy: status.policy.clone(),
                    knob,
                }
                .to_string(),
            ),
        }
    }

    /// Whether somebody at the node has set a value of a camera.
    pub fn set_locally(&self) -> bool {
        let status = self.status.as_ref();
        status.is_some_and(|status| {
            status
                .cameras
                .iter()
                .any(|c| c.knob_source == KnobSource::Local)
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
            generation: self.generation,
            knob: self.knob(),
            target: self.target(),
            cannot_hold: self.cannot_hold(),
            refused: refused.map(|refused| (refused.generation, refused.reason.clone())),
        }
    }
}
