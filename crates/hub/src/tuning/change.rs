//! Orders changes by hand, of a threshold or a target on selected nodes, and collects the outcomes.

use super::member::{Ask, ChangeNode, Millis, Outcome};
use super::selector::Selector;
use super::tuner::Tuner;
use crate::presence::NodeView;
use crate::store::{ChangeRow, StoreError};
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use tokio::time::{Instant, timeout_at};
use utoipa::ToSchema;

/// A change of selected nodes. The setting is a further field: the threshold under the policy's name for it, such as
/// `"u": 5e-4`, or `target`.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct NewChange {
    /// Selects the nodes: names, globs, labels, `all`.
    #[schema(value_type = Vec<String>, examples(json!(["cam-*", "region=north"])))]
    pub select: Selector,
    /// True to report only which nodes would change.
    #[serde(default)]
    pub dry_run: bool,
    /// The reason, for the history.
    #[serde(default)]
    pub why: String,
    /// Time to wait for the nodes, seconds: 5 by default, at most 8 for a plain answer.
    #[serde(default)]
    pub wait_s: Option<f64>,
}

/// A change that was ordered, or would be without `dry_run`.
#[derive(Debug, Default)]
pub struct Change {
    /// Its revision; absent in a dry run, and if no node would change.
    pub(crate) revision: Option<u64>,
    /// Outcomes that were not reported to the caller yet; those of nodes whose answers are awaited are pending.
    pub(crate) lines: Vec<ChangeNode>,
}

impl Tuner {
    /// Orders a setting for the selected nodes, or only finds the nodes that would change.
    ///
    /// # Errors
    /// When the database cannot be used: then nothing is ordered.
    pub async fn change(
        &self,
        setting: DesiredSetting,
        request: NewChange,
        who: &str,
        now: Millis,
    ) -> Result<Change, StoreError> {
        let mut change = Change::default();
        let line = |node: &str, outcome, from, detail: &str| ChangeNode {
            node: node.to_owned(),
            from,
            ask: Ask {
                detail: detail.to_owned(),
                ..Ask::new(0, now, outcome)
            },
        };
        let taken = self.taken().await?;
        let mut known = HashSet::new();
        let is_selected = |node: &NodeView| request.select.selects(&node.node, node.labels());
        for node in self.fleet.views(is_selected) {
            known.insert(node.node.clone());
            let taken = (taken.get(&node.node))
                .map(|other| format!("takes part in {other}: end or return that first"));
            let refused = taken.or_else(|| self.implausible(node.revision));
            let refused = refused.or_else(|| unable(&node, setting));
            let (outcome, detail) = match &refused {
                Some(detail) => (Outcome::Refused, detail.as_str()),
                None if self.has_it(&node, setting) => (Outcome::Unchanged, ""),
                None if !request.dry_run => (Outcome::Pending, ""),
                None if node.is_reachable() => (Outcome::WouldChange, ""),
                None => (
                    Outcome::WouldChange,
                    "out of reach: it would change when it returns",
                ),
            };
            (change.lines).push(line(&node.node, outcome, node.setting(), detail));
        }
        for name in request.select.named() {
            if known.insert(name.to_owned()) {
                let detail = "no node has that name";
                (change.lines).push(line(name, Outcome::Refused, None, detail));
            }
        }
        let awaited = (change.lines.iter()).filter(|line| line.ask.outcome == Outcome::Pending);
        let awaited: Vec<_> = awaited.map(|line| line.node.clone()).collect();
        if !awaited.is_empty() {
            let row = ChangeRow {
                revision: 0,
                at_ms: now,
                who: who.to_owned(),
                why: request.why,
                origin: "hand".to_owned(),
                selector: request.select.to_string(),
                setting,
            };
            change.revision = Some(self.order(row, awaited).await?);
        }
        Ok(change)
    }

    /// Waits for outcomes that were not returned yet; at `until` all other nodes get the outcome "pending". Returns nothing once
    /// every node was returned.
    pub(crate) async fn outcomes(&self, change: &mut Change, until: Instant) -> Vec<ChangeNode> {
        loop {
            let looked = self.looked.notified();
            let is_over = Instant::now() >= until;
            for line in &mut change.lines {
                if line.ask.outcome == Outcome::Pending {
                    self.update(line, change.revision.unwrap_or(0));
                }
                if line.ask.outcome == Outcome::Pending && is_over {
                    line.ask.detail = "not answered yet".to_owned();
                }
            }
            let is_known = |line: &mut ChangeNode| is_over || line.ask.outcome != Outcome::Pending;
            let mut lines: Vec<_> = change.lines.extract_if(.., is_known).collect();
            if !lines.is_empty() || change.lines.is_empty() {
                lines.sort_by(|a, b| a.node.cmp(&b.node));
                return lines;
            }
            let _ = timeout_at(until, looked).await;
        }
    }

    /// True if the node has the setting, and no other setting is desired that would replace it. "No target" is compatible with
    /// any desired threshold.
    fn has_it(&self, node: &NodeView, setting: DesiredSetting) -> bool {
        let desired = (self.desires.get(&node.node)).map(|desired| desired.setting);
        let wanted = match setting {
            DesiredSetting::Target(None) => {
                !matches!(desired, Some(DesiredSetting::Target(Some(_))))
            }
            _ => desired == Some(setting),
        };
        wanted && node.has(setting)
    }
}

/// The reason that the node cannot have the setting, according to its status; `None` if it can.
fn unable(node: &NodeView, setting: DesiredSetting) -> Option<String> {
    match setting {
        DesiredSetting::Threshold(wanted) => {
            let name = node.threshold_name().filter(|name| *name != wanted.name)?;
            let wanted = wanted.name;
            Some(format!(
                "the threshold of its policy is `{name}`, not `{wanted}`"
            ))
        }
        DesiredSetting::Target(Some(_)) => node.cannot_hold(),
        DesiredSetting::Target(None) => None,
    }
}
