//! A value or a target for selected nodes, by hand: who would change, who cannot, and what became of it.

use super::member::{Millis, Outcome};
use super::selector::Selector;
use super::tuner::{NewOrder, OutcomeLine, Tuner};
use crate::desired::DesiredValue;
use crate::presence::NodeSettings;
use crate::setting::is_applied;
use crate::store::StoreError;
use albireo_wire::DesiredSetting;
use std::collections::{BTreeMap, HashSet};

/// A value or a target for selected nodes.
#[derive(Clone, Debug)]
pub struct ChangeRequest {
    /// The value or the target.
    pub setting: DesiredSetting,
    /// Which nodes.
    pub select: Selector,
    /// Only says who would change.
    pub dry_run: bool,
    /// Why.
    pub why: String,
}

/// An order that was given, or would be.
#[derive(Debug)]
pub struct Change {
    /// What was ordered.
    pub(crate) setting: DesiredSetting,
    /// Its revision; absent in a dry run, and if no node would change.
    pub(crate) revision: Option<u64>,
    /// What is known and not reported yet.
    pub(crate) lines: Vec<OutcomeLine>,
    /// Nodes whose answer is awaited, with what they have.
    pub(crate) awaited: BTreeMap<String, Option<DesiredSetting>>,
}

impl Tuner {
    /// Orders a value or a target for the selected nodes, or says who would change.
    ///
    /// # Errors
    /// When the database cannot be used: then nothing is ordered.
    pub async fn change(
        &self,
        request: ChangeRequest,
        who: &str,
        now: Millis,
    ) -> Result<Change, StoreError> {
        let ChangeRequest {
            setting,
            select,
            dry_run,
            why,
        } = request;
        let taken = self.taken().await?;
        let (mut lines, mut nodes, mut known) = (Vec::new(), Vec::new(), HashSet::new());
        let line = |node: &str, outcome, from, detail| OutcomeLine {
            node: node.to_owned(),
            outcome,
            from,
            to: setting,
            detail,
        };
        for node in self.fleet.all_settings() {
            if !select.selects(&node.name, node.labels()) {
                continue;
            }
            known.insert(node.name.to_string());
            let from = node.setting();
            let taken = (taken.get(&*node.name))
                .map(|other| format!("takes part in {other}: end or return that first"));
            let refused = taken.or_else(|| self.implausible(node.revision));
            let (outcome, detail) = match refused.or_else(|| unable(&node, setting)) {
                Some(detail) => (Outcome::Refused, detail),
                None if has_it(&node, self.desired_value(&node.name), setting) => {
                    (Outcome::Unchanged, String::new())
                }
                None if dry_run && node.reachable => (Outcome::WouldChange, String::new()),
                None if dry_run => {
                    let detail = "out of reach: on its return".to_owned();
                    (Outcome::WouldChange, detail)
                }
                None => {
                    nodes.push((node.name.to_string(), from));
                    continue;
                }
            };
            lines.push(line(&node.name, outcome, from, detail));
        }
        for name in select.named().filter(|name| !known.contains(*name)) {
            let detail = "there is no node of that name".to_owned();
            lines.push(line(name, Outcome::Refused, None, detail));
        }
        lines.sort_by(|a, b| a.node.cmp(&b.node));
        let awaited = nodes.iter().cloned().collect();
        let revision = if nodes.is_empty() {
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
            Some(self.order(order, now).await?)
        };
        Ok(Change {
            setting,
            revision,
            lines,
            awaited,
        })
    }
}

/// Why the node cannot have that, according to its status.
fn unable(facts: &NodeSettings, setting: DesiredSetting) -> Option<String> {
    match setting {
        DesiredSetting::Threshold(knob) => {
            let name = facts.threshold_name().filter(|name| *name != knob.name)?;
            let words = format!(
                "the threshold of its policy is `{name}`, not `{}`",
                knob.name
            );
            Some(words)
        }
        DesiredSetting::Target(Some(_)) => facts.cannot_hold(),
        DesiredSetting::Target(None) => None,
    }
}

/// Whether the node has it, and nothing else is desired that would take it away. Where no target is wanted, a desired
/// threshold stays.
fn has_it(facts: &NodeSettings, desired: Option<DesiredValue>, setting: DesiredSetting) -> bool {
    let desired = desired.map(|desired| desired.setting);
    let wanted = match setting {
        DesiredSetting::Target(None) => !matches!(desired, Some(DesiredSetting::Target(Some(_)))),
        _ => desired == Some(setting),
    };
    wanted && facts.is_known() && is_applied(setting, facts.threshold(), facts.target())
}
