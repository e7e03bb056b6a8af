//! What tuning needs to know of the fleet: each node's labels, its values in force, and whether it is in reach.

use super::members::Seen;
use crate::presence::{self, NodeView, PresenceState};
use albireo_wire::{KnobSource, KnobValue, NodeStatus};
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
            refused: refused.map(|refused| (refused.generation, refused.reason.clone())),
        }
    }
}
