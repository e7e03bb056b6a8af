//! Orders changes by hand, of a threshold or a target on selected nodes, and collects the outcomes.

use super::member::{Ask, ChangeNode, Millis, Outcome};
use super::selector::Selector;
use super::tables::ChangeRow;
use super::tuner::Tuner;
use crate::presence::NodeView;
use crate::store::StoreError;
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};
use utoipa::ToSchema;

/// Interval at which the outcomes of a change are looked up for its caller.
const OUTCOMES_EVERY: Duration = Duration::from_millis(100);

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

/// The result of a change, and the last line of a stream.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct OrderAnswer {
    /// Revision of the order: `/api/v1/changes/{revision}` shows its progress. Absent in a dry run, and if no node would change.
    pub revision: Option<u64>,
    /// The number of nodes by outcome.
    pub counts: BTreeMap<Outcome, usize>,
    /// The outcome at each node; absent in a stream, which had them before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(required)]
    pub nodes: Vec<ChangeNode>,
}

impl Tuner {
    /// Orders a setting for the selected nodes, or only finds the nodes that would change. In the answer, nodes whose answers
    /// are awaited are pending, and nothing is counted yet.
    ///
    /// # Errors
    /// When the database cannot be used: then nothing is ordered.
    pub async fn change(
        &self,
        setting: DesiredSetting,
        request: NewChange,
        who: &str,
        now: Millis,
    ) -> Result<OrderAnswer, StoreError> {
        let mut change = OrderAnswer::default();
        let mut line = |node: String, from, outcome, detail: String| {
            let ask = Ask {
                detail,
                ..Ask::new(0, now, outcome)
            };
            change.nodes.push(ChangeNode { node, from, ask });
        };
        let taken = self.taken().await?;
        let is_selected = |node: &NodeView| request.select.selects(&node.node, node.labels());
        for node in self.fleet.views(is_selected) {
            let taken = taken
                .get(&node.node)
                .map(|other| format!("takes part in {other}: end or return that first"));
            let refused = taken.or_else(|| self.implausible(node.revision));
            let (outcome, detail) = match refused.or_else(|| node.unable(setting)) {
                Some(detail) => (Outcome::Refused, detail),
                None if self.has_it(&node, setting) => (Outcome::Unchanged, String::new()),
                None if !request.dry_run => (Outcome::Pending, String::new()),
                None if node.is_reachable() => (Outcome::WouldChange, String::new()),
                None => (
                    Outcome::WouldChange,
                    "out of reach: it would change when it returns".to_owned(),
                ),
            };
            let from = node.setting();
            line(node.node, from, outcome, detail);
        }
        for name in request.select.named() {
            if self.fleet.view(name).is_none() {
                let detail = "no node has that name".to_owned();
                line(name.to_owned(), None, Outcome::Refused, detail);
            }
        }
        let awaited: Vec<_> = change
            .nodes
            .iter()
            .filter(|line| line.ask.outcome == Outcome::Pending)
            .map(|line| line.node.clone())
            .collect();
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

    /// Waits for outcomes of nodes that `change` still has, counts them, and moves their nodes out of it. At `until` it returns
    /// all other nodes with the outcome "pending".
    pub(crate) async fn outcomes(
        &self,
        change: &mut OrderAnswer,
        until: Instant,
    ) -> Vec<ChangeNode> {
        loop {
            let is_over = Instant::now() >= until;
            for line in &mut change.nodes {
                if line.ask.outcome != Outcome::Pending {
                    continue;
                }
                match self.desires.get(&line.node).map(|wanted| wanted.at.ask) {
                    Some(ask) if Some(ask.revision) == change.revision => line.ask = ask,
                    Some(_) => line.ask.outcome = Outcome::Superseded,
                    None => {
                        line.ask.outcome = Outcome::Missed;
                        line.ask.detail = "the node was forgotten".to_owned();
                    }
                }
                if line.ask.outcome == Outcome::Pending && is_over {
                    line.ask.detail = "not answered yet".to_owned();
                }
            }
            let is_known = |line: &mut ChangeNode| is_over || line.ask.outcome != Outcome::Pending;
            let mut lines: Vec<_> = change.nodes.extract_if(.., is_known).collect();
            if is_over || !lines.is_empty() {
                for line in &lines {
                    *change.counts.entry(line.ask.outcome).or_default() += 1;
                }
                lines.sort_by(|a, b| a.node.cmp(&b.node));
                return lines;
            }
            sleep_until(until.min(Instant::now() + OUTCOMES_EVERY)).await;
        }
    }

    /// True if the node has the setting, and no other setting is desired that would replace it. "No target" is compatible with
    /// any desired threshold.
    fn has_it(&self, node: &NodeView, setting: DesiredSetting) -> bool {
        let desired = self.desires.get(&node.node).map(|wanted| wanted.setting);
        let wanted = match setting {
            DesiredSetting::Target(None) => {
                !matches!(desired, Some(DesiredSetting::Target(Some(_))))
            }
            _ => desired == Some(setting),
        };
        wanted && node.has(setting)
    }
}
