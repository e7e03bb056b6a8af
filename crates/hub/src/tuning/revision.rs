//! Gives a desired setting to selected nodes by hand, under one revision, and collects the outcomes.

use super::desired::NodeSetting;
use super::member::Millis;
use super::outcome::Outcome;
use super::selector::Selector;
use super::tuner::Tuner;
use crate::presence::NodeView;
use crate::store::StoreError;
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};
use utoipa::ToSchema;

/// Interval at which outcomes are looked up for the caller.
const OUTCOMES_EVERY: Duration = Duration::from_millis(100);

/// Gives selected nodes a desired setting. The setting is a further field: the threshold under the policy's name for it,
/// such as `"u": 5e-4`, or `target`.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct NewRevision {
    /// Selects the nodes: names, globs, labels, `all`.
    #[schema(value_type = Vec<String>, examples("cam-*", "region=north"))]
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

/// A desired setting that was given to some nodes at once.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Revision {
    /// Its number, which nodes report with their setting: `/api/v1/revisions/{revision}` shows its progress. Absent in a dry
    /// run, and if no node would change.
    #[serde(rename = "revision")]
    pub number: Option<u64>,
    /// When, milliseconds since the Unix epoch.
    pub at_ms: Millis,
    /// The name of the caller's token.
    pub who: String,
    /// The reason.
    pub why: String,
    /// Its origin: `hand`, `rollout 3`, `trial 4`, `drift`.
    pub origin: String,
    /// The selector; empty for a rollout or trial.
    #[serde(rename = "select")]
    pub selector: String,
    /// The setting: a threshold, or a target (null switches it off).
    #[serde(rename = "to")]
    pub setting: DesiredSetting,
    /// The number of nodes by outcome.
    pub counts: BTreeMap<Outcome, usize>,
    /// The outcome at each node; absent in a list, and at the end of a stream, which had them before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(required)]
    pub nodes: Vec<NodeSetting>,
}

impl Tuner {
    /// Gives the selected nodes a setting, or only finds the nodes that would change. In the answer, nodes that have not
    /// answered yet are pending, and nothing is counted.
    ///
    /// # Errors
    /// When the database cannot be used: then nothing is given.
    pub async fn set(
        &self,
        setting: DesiredSetting,
        request: NewRevision,
        who: &str,
        now: Millis,
    ) -> Result<Revision, StoreError> {
        let mut nodes = Vec::new();
        let taken = self.taken().await?;
        let is_selected = |node: &NodeView| request.select.selects(&node.node, node.labels());
        for node in self.fleet.views(is_selected) {
            let refusal = match taken.get(&node.node) {
                Some(other) => Some(format!("takes part in {other}: end or return that first")),
                None => self.refusal(&node, setting),
            };
            let outcome = if refusal.is_some() {
                Outcome::Refused
            } else if self.has_it(&node, setting) {
                Outcome::Unchanged
            } else if request.dry_run {
                Outcome::WouldChange
            } else {
                Outcome::Pending
            };
            let from = node.setting();
            let is_reachable = node.is_reachable();
            let mut desired = NodeSetting::new(node.node, setting, from, outcome, now);
            if let Some(reason) = refusal {
                desired.given.detail = reason;
            } else if outcome == Outcome::WouldChange && !is_reachable {
                let detail = "out of reach: it would change when it returns";
                desired.given.detail = detail.to_owned();
            }
            nodes.push(desired);
        }
        for name in request.select.named() {
            if self.fleet.view(name).is_none() {
                let outcome = Outcome::Refused;
                let mut desired = NodeSetting::new(name.to_owned(), setting, None, outcome, now);
                desired.given.detail = "no node has that name".to_owned();
                nodes.push(desired);
            }
        }
        let mut revision = Revision {
            number: None,
            at_ms: now,
            who: who.to_owned(),
            why: request.why,
            origin: "hand".to_owned(),
            selector: request.select.to_string(),
            setting,
            counts: BTreeMap::new(),
            nodes: Vec::new(),
        };
        let given: Vec<String> = nodes
            .iter()
            .filter(|node| node.given.outcome == Outcome::Pending)
            .map(|node| node.node.clone())
            .collect();
        if !given.is_empty() {
            revision.number = Some(self.give(revision.clone(), given).await?);
        }
        Ok(Revision { nodes, ..revision })
    }

    /// Waits for outcomes of nodes that `revision` still has, counts them, and moves their nodes out of it. At `until` it
    /// returns all other nodes with the outcome "pending".
    pub(crate) async fn outcomes(
        &self,
        revision: &mut Revision,
        until: Instant,
    ) -> Vec<NodeSetting> {
        loop {
            let is_over = Instant::now() >= until;
            for node in &mut revision.nodes {
                if node.given.outcome != Outcome::Pending {
                    continue;
                }
                match self.desired.get(&node.node).map(|desired| desired.given) {
                    Some(given) if Some(given.revision) == revision.number => node.given = given,
                    Some(_) => node.given.outcome = Outcome::Superseded,
                    None => {
                        node.given.outcome = Outcome::Missed;
                        node.given.detail = "the node was forgotten".to_owned();
                    }
                }
                if node.given.outcome == Outcome::Pending && is_over {
                    node.given.detail = "not answered yet".to_owned();
                }
            }
            let is_known =
                |node: &mut NodeSetting| is_over || node.given.outcome != Outcome::Pending;
            let mut known: Vec<_> = revision.nodes.extract_if(.., is_known).collect();
            if is_over || !known.is_empty() {
                for node in &known {
                    *revision.counts.entry(node.given.outcome).or_default() += 1;
                }
                known.sort_by(|a, b| a.node.cmp(&b.node));
                return known;
            }
            sleep_until(until.min(Instant::now() + OUTCOMES_EVERY)).await;
        }
    }

    /// The reason that the node cannot be given the setting; `None` if it can.
    fn refusal(&self, node: &NodeView, setting: DesiredSetting) -> Option<String> {
        if let Some(reason) = self.implausible(node.revision) {
            return Some(reason);
        }
        node.unable(setting)
    }

    /// True if the node has the setting, and no other setting is desired that would replace it. "No target" is compatible with
    /// any desired threshold.
    fn has_it(&self, node: &NodeView, setting: DesiredSetting) -> bool {
        let desired = self.desired.get(&node.node).map(|desired| desired.setting);
        let holds_target = matches!(desired, Some(DesiredSetting::Target(Some(_))));
        let is_desired = match setting {
            DesiredSetting::Target(None) => !holds_target,
            _ => desired == Some(setting),
        };
        is_desired && node.has(setting)
    }
}
