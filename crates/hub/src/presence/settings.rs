//! What is known of a node's settings. It is read once from each full status, so that following settings parses nothing.

use super::entry::Entry;
use albireo_wire::{DesiredSetting, NodeStatus, NodeTarget, Target, Threshold, ThresholdName};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The settings that a node reported in its last full status.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ReportedSettings {
    labels: BTreeMap<String, String>,
    policy: String,
    /// Name of its policy's threshold, when a camera reports it.
    threshold_name: Option<ThresholdName>,
    /// The threshold in force on all of its cameras; `None` when they differ or have none.
    threshold: Option<Threshold>,
    pub(super) target: Option<NodeTarget>,
    target_off: Option<String>,
    refused: Option<(u64, String)>,
}

impl From<&NodeStatus> for ReportedSettings {
    fn from(status: &NodeStatus) -> Self {
        let cameras = || status.cameras.iter().map(|camera| camera.threshold);
        let first = cameras().next().flatten();
        let named = cameras().flatten().next();
        let refused = status.refused.as_ref();
        Self {
            labels: status.labels.clone(),
            policy: status.policy.clone(),
            threshold_name: named.map(|threshold| threshold.name),
            threshold: first.filter(|_| cameras().all(|other| other == first)),
            target: status.target,
            target_off: status.target_off.clone(),
            refused: refused.map(|refused| (refused.revision, refused.reason.clone())),
        }
    }
}

/// What the hub knows of a node's settings.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NodeSettings {
    /// Its name.
    pub(crate) name: Arc<str>,
    /// Whether it is in reach: online or degraded.
    pub(crate) reachable: bool,
    /// Revision in force that it reported last.
    pub(crate) revision: u64,
    reported: Option<Arc<ReportedSettings>>,
}

impl NodeSettings {
    pub(super) fn of(name: &Arc<str>, entry: &Entry) -> Self {
        Self {
            name: Arc::clone(name),
            reachable: entry.state.is_heard(),
            revision: entry.revision,
            reported: entry.reported.clone(),
        }
    }

    /// Whether it ever sent a full status.
    pub(crate) const fn is_known(&self) -> bool {
        self.reported.is_some()
    }

    /// Its labels.
    pub(crate) fn labels(&self) -> &BTreeMap<String, String> {
        labels(self.reported.as_deref())
    }

    /// The threshold in force on all of its cameras; `None` when they differ, have none, or nothing is known.
    pub(crate) fn threshold(&self) -> Option<Threshold> {
        self.reported.as_ref()?.threshold
    }

    /// Name of its policy's threshold, when a camera reports it.
    pub(crate) fn threshold_name(&self) -> Option<ThresholdName> {
        self.reported.as_ref()?.threshold_name
    }

    /// The target that it holds.
    pub(crate) fn target(&self) -> Option<Target> {
        Some(self.reported.as_ref()?.target?.target)
    }

    /// Whether it reported that setting. A threshold that a target has moved to is on its way elsewhere, and does not count.
    pub(crate) fn has(&self, setting: DesiredSetting) -> bool {
        self.is_known()
            && match setting {
                DesiredSetting::Threshold(wanted) => {
                    self.threshold() == Some(wanted) && self.target().is_none()
                }
                DesiredSetting::Target(wanted) => self.target() == wanted,
            }
    }

    /// What it has: its target, or its threshold where it holds none.
    pub(crate) fn setting(&self) -> Option<DesiredSetting> {
        let target = self
            .target()
            .map(|target| DesiredSetting::Target(Some(target)));
        target.or_else(|| self.threshold().map(DesiredSetting::Threshold))
    }

    /// Why it holds no target any more, in its own words.
    pub(crate) fn target_off(&self) -> Option<String> {
        self.reported.as_ref()?.target_off.clone()
    }

    /// The revision that it refused, and why.
    pub(crate) fn refused(&self) -> Option<(u64, String)> {
        self.reported.as_ref()?.refused.clone()
    }

    /// Why it cannot hold a target, as far as its status shows.
    pub(crate) fn cannot_hold(&self) -> Option<String> {
        // Before its cameras have reported, the node itself knows.
        let name = self.threshold_name()?;
        let policy = &self.reported.as_ref()?.policy;
        (!matches!(name.as_str(), "u" | "lambda"))
            .then(|| format!("a target moves `u` or `lambda`, and policy `{policy}` has `{name}`"))
    }
}

/// The labels of a node.
pub(super) fn labels(reported: Option<&ReportedSettings>) -> &BTreeMap<String, String> {
    static NONE: BTreeMap<String, String> = BTreeMap::new();
    reported.map_or(&NONE, |reported| &reported.labels)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A node with one value on all of its cameras, which refused the setting of one revision or none.
    pub(crate) fn reported(
        reachable: bool,
        revision: u64,
        threshold: Threshold,
        refused: Option<u64>,
    ) -> NodeSettings {
        let reported = ReportedSettings {
            labels: BTreeMap::new(),
            policy: "albireo".to_owned(),
            threshold_name: Some(threshold.name),
            threshold: Some(threshold),
            target: None,
            target_off: None,
            refused: refused.map(|revision| (revision, "range".to_owned())),
        };
        NodeSettings {
            name: "".into(),
            reachable,
            revision,
            reported: Some(Arc::new(reported)),
        }
    }
}
