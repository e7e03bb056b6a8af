//! Says which clips a run measures.

use super::super::member::{Member, Millis};
use super::super::metric::BeforeAfter;
use super::{Kind, Run, milliseconds};
use albireo_wire::Threshold;
use serde::Serialize;
use std::collections::HashMap;

/// Clips to measure: those of a node with this value in force that were received in this time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Window {
    pub(crate) node: String,
    /// Name of the threshold.
    pub(crate) threshold: String,
    /// Its value, in the shortest text that reads back as the same.
    pub(crate) value: String,
    pub(crate) from_ms: Millis,
    pub(crate) until_ms: Millis,
}

impl Window {
    fn new(node: &str, value: Threshold, from_ms: Millis, until_ms: Millis) -> Self {
        Self {
            node: node.to_owned(),
            threshold: value.name.to_string(),
            value: value.value.to_string(),
            from_ms,
            until_ms,
        }
    }
}

/// Measurements, by node.
pub(crate) type Measured = HashMap<String, BeforeAfter>;

impl Run {
    /// The windows to measure: of the nodes with their new value, before they were given it and since; of the nodes that were not
    /// given it yet, over the same hours.
    pub(crate) fn windows(&self, now: Millis) -> Vec<[Window; 2]> {
        let baseline = milliseconds(self.kind.basics().baseline_s);
        let since = self.since_ms;
        let stage_given_ms = self
            .members
            .iter()
            .filter(|m| self.is_in_stage(m))
            .map(|m| m.given.given_ms)
            .min()
            .unwrap_or(since);
        let windows = |member: &Member, given: Millis, value: Threshold, from: Millis| {
            Some([
                Window::new(&member.node, member.before, given - baseline, given),
                Window::new(&member.node, value, from, now),
            ])
        };
        self.members
            .iter()
            .filter_map(|member| match member.applied_ms() {
                // After a resumption only later clips count.
                Some(applied) if self.is_in_stage(member) => {
                    let given_ms = member.given.given_ms;
                    windows(member, given_ms, member.value?, applied.max(since))
                }
                _ if self.is_later(member) => windows(member, stage_given_ms, member.before, since),
                _ => None,
            })
            .collect()
    }

    /// True if the member was not given its value yet.
    pub(super) fn is_later(&self, member: &Member) -> bool {
        matches!(self.kind, Kind::Rollout { .. }) && member.group >= self.stage
    }
}
