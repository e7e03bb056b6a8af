//! A value or a target for selected nodes, by hand: who would change, who cannot, and what became of it.

use super::desired::DesiredValue;
use super::fleet::NodeFacts;
use super::selector::Selector;
use super::tuner::{NewOrder, OutcomeLine, Tuner};
use crate::setting::Setting;
use crate::store::StoreError;
use std::collections::HashSet;
use tokio::sync::mpsc;

/// A value or a target for selected nodes.
#[derive(Clone, Debug)]
pub(crate) struct ChangeRequest {
    pub(crate) setting: Setting,
    pub(crate) select: Selector,
    pub(crate) dry_run: bool,
    pub(crate) why: String,
}

/// An order that was given, or would be.
#[derive(Debug)]
pub(crate) struct Change {
    /// What was ordered.
    pub(crate) setting: Setting,
    /// Its generation; absent in a dry run, and where nobody was to change.
    pub(crate) generation: Option<u64>,
    /// What is known at once.
    pub(crate) lines: Vec<OutcomeLine>,
    /// Nodes whose answer is awaited.
    pub(crate) awaited: HashSet<String>,
    /// Brings their answers.
    pub(crate) follow: mpsc::UnboundedReceiver<OutcomeLine>,
}

impl Tuner {
    /// Orders a value or a target for the selected nodes, or says who would change.
    pub(crate) async fn change(
        &self,
        request: ChangeRequest,
        who: &str,
    ) -> Result<Change, StoreError> {
        let ChangeRequest {
            setting,
            select,
            dry_run,
            why,
        } = request;
        let taken = Self::taken(&*self.campaigns.lock().await);
        let (mut lines, mut nodes, mut known) = (Vec::new(), Vec::new(), HashSet::new());
        let line = |node: &str, outcome, from, detail: String| OutcomeLine {
            node: node.to_owned(),
            outcome,
            from,
            to: setting,
            detail,
        };
        for facts in self.fleet.nodes() {
            if !select.selects(&facts.name, &facts.labels()) {
                continue;
            }
            known.insert(facts.name.clone());
            let from = facts.setting();
            if let Some(other) = taken.get(&facts.name) {
                let detail = format!("takes part in {other}: end or return that first");
                lines.push(line(&facts.name, "refused", from, detail));
            } else if let Some(detail) = unable(&facts, setting) {
                lines.push(line(&facts.name, "refused", from, detail));
            } else if has_it(&facts, self.desired_value(&facts.name), setting) {
                lines.push(line(&facts.name, "unchanged", from, String::new()));
            } else if dry_run {
                let detail = if facts.reachable {
                    ""
                } else {
                    "out of reach: on its return"
                };
                lines.push(line(&facts.name, "would_change", from, detail.to_owned()));
            } else {
                nodes.push((facts.name, from));
            }
        }
        for name in select.named().filter(|name| !known.contains(*name)) {
            lines.push(line(
                name,
                "refused",
                None,
                "there is no node of that name".to_owned(),
            ));
        }
        lines.sort_by(|a, b| a.node.cmp(&b.node));
        let awaited = nodes.iter().map(|(node, _)| node.clone()).collect();
        let (tell, follow) = mpsc::unbounded_channel();
        let generation = if nodes.is_empty() {
            None
        } else {
            let order = NewOrder {
                setting,
                nodes,
                who: who.to_owned(),
                why,
                origin: "hand".to_owned(),
                selector: select.to_string(),
            };
            Some(self.order(order, Some(tell)).await?)
        };
        Ok(Change {
            setting,
            generation,
            lines,
            awaited,
            follow,
        })
    }
}

/// Why the node cannot have that, as far as its status tells.
fn unable(facts: &NodeFacts, setting: Setting) -> Option<String> {
    match setting {
        Setting::Knob(knob) => {
            let name = facts.knob_name().filter(|name| *name != knob.name)?;
            let words = format!("its policy is turned by `{name}`, not by `{}`", knob.name);
            Some(words)
        }
        Setting::Hold(_) => facts.cannot_hold(),
        Setting::HoldNothing => None,
    }
}

/// Whether the node has it, and nothing else is desired that would take it away. Where nothing is to be held, whatever
/// else is desired stands.
fn has_it(facts: &NodeFacts, desired: Option<DesiredValue>, setting: Setting) -> bool {
    let desired = desired.map(|desired| desired.setting);
    let wanted = match setting {
        Setting::HoldNothing => !matches!(desired, Some(Setting::Hold(_))),
        _ => desired == Some(setting),
    };
    wanted && facts.status.is_some() && setting.is_had(facts.knob(), facts.target())
}
