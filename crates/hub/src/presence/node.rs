//! Defines a node as the hub knows it, and reads its settings from its last full status.

use super::today::TodaysEnergy;
use crate::named::named;
use albireo_wire::{DesiredSetting, NodeStatus, Target, Threshold, ThresholdName};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use utoipa::ToSchema;

named! {
    /// The state of a node.
    #[derive(Default)]
    pub enum PresenceState {
        /// It sends status messages, and every part works.
        Online = "online",
        /// It sends status messages, and a part does not work.
        Degraded = "degraded",
        /// It sent no status for a while.
        #[default]
        Silent = "silent",
        /// It sent no status for long, or its liveliness token disappeared.
        Offline = "offline",
    }
}

/// A node, as the HTTP interface shows it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NodeView {
    /// Its name.
    pub node: String,
    /// Its state.
    pub state: PresenceState,
    /// When that state began, milliseconds since the Unix epoch.
    pub since_ms: i64,
    /// The reason for the state; empty when online.
    pub why: String,
    /// When the last status was received, milliseconds since the Unix epoch.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heard_ms: Option<i64>,
    /// Reports that wait in its outbox.
    pub waiting: u64,
    /// The revision in force at the node.
    pub revision: u64,
    /// The energy and skip rate of its clips of today (UTC).
    pub today: TodaysEnergy,
    /// True if a report of it was stored before this hub started.
    #[serde(default, skip_serializing)]
    #[schema(ignore)]
    pub(crate) has_reported: bool,
    /// The last full status.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<NodeStatus>)]
    pub status: Option<Arc<NodeStatus>>,
}

impl NodeView {
    /// True if it is in reach: online or degraded.
    pub(crate) const fn is_reachable(&self) -> bool {
        matches!(self.state, PresenceState::Online | PresenceState::Degraded)
    }

    /// Its labels.
    pub(crate) fn labels(&self) -> &BTreeMap<String, String> {
        static NONE: BTreeMap<String, String> = BTreeMap::new();
        self.status.as_ref().map_or(&NONE, |status| &status.labels)
    }

    /// The threshold in force on all of its cameras; `None` if they differ, have none, or are not known.
    pub(crate) fn threshold(&self) -> Option<Threshold> {
        let cameras = &self.status.as_ref()?.cameras;
        let first = cameras.first()?.threshold;
        if cameras.iter().any(|camera| camera.threshold != first) {
            return None;
        }
        first
    }

    /// The name of its policy's threshold, if a camera reports one.
    pub(crate) fn threshold_name(&self) -> Option<ThresholdName> {
        self.status
            .as_ref()?
            .cameras
            .iter()
            .find_map(|camera| Some(camera.threshold?.name))
    }

    /// The target that it holds.
    pub(crate) fn target(&self) -> Option<Target> {
        Some(self.status.as_ref()?.target?.target)
    }

    /// True if it reported that setting. A threshold does not count while a target moves it.
    pub(crate) fn has(&self, setting: DesiredSetting) -> bool {
        if self.status.is_none() {
            return false;
        }
        match setting {
            DesiredSetting::Threshold(wanted) => {
                self.threshold() == Some(wanted) && self.target().is_none()
            }
            DesiredSetting::Target(wanted) => self.target() == wanted,
        }
    }

    /// Its target, or its threshold if it holds no target.
    pub(crate) fn setting(&self) -> Option<DesiredSetting> {
        match self.target() {
            Some(target) => Some(DesiredSetting::Target(Some(target))),
            None => self.threshold().map(DesiredSetting::Threshold),
        }
    }

    /// The reason that it cannot have the setting, as far as its status shows; `None` if it can.
    pub(crate) fn unable(&self, setting: DesiredSetting) -> Option<String> {
        // Until its cameras have reported a threshold, only the node itself knows.
        let name = self.threshold_name()?;
        let policy = &self.status.as_ref()?.policy;
        match setting {
            DesiredSetting::Threshold(Threshold { name: wanted, .. }) if wanted != name => Some(
                format!("the threshold of its policy is `{name}`, not `{wanted}`"),
            ),
            DesiredSetting::Target(Some(_)) if !matches!(name.as_str(), "u" | "lambda") => Some(
                format!("a target moves `u` or `lambda`, and policy `{policy}` has `{name}`"),
            ),
            _ => None,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use albireo_wire::RefusedRevision;
    use serde_json::json;
    use std::sync::LazyLock;

    pub(crate) static STATUS: LazyLock<NodeStatus> = LazyLock::new(|| {
        let status = json!({
            "version": "", "cameras": [{"name": "", "state": "live", "threshold_source": "hub"}], "policy": "",
            "model": "", "power_source": "", "power_quality": "measured", "health": {"state": "ready", "reasons": {}},
            "outbox": {"waiting": 0, "lost": 0, "durable": true},
        });
        serde_json::from_value(status).unwrap()
    });

    /// A node that is online, with one value on all of its cameras.
    pub(crate) fn reported(revision: u64, threshold: Threshold) -> NodeView {
        let mut status = STATUS.clone();
        status.cameras[0].threshold = Some(threshold);
        NodeView {
            state: PresenceState::Online,
            revision,
            status: Some(Arc::new(status)),
            ..NodeView::default()
        }
    }

    impl NodeView {
        /// The same node once it is out of reach.
        pub(crate) fn silent(self) -> Self {
            Self {
                state: PresenceState::Silent,
                ..self
            }
        }

        /// The same node once it has refused the setting of a revision.
        pub(crate) fn refusing(mut self, revision: u64) -> Self {
            let status = self.status.as_mut().map(Arc::make_mut).unwrap();
            status.refused = Some(RefusedRevision {
                revision,
                reason: "range".to_owned(),
            });
            self
        }
    }
}
