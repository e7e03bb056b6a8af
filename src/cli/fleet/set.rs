//! Runs the commands `set-u`, `set-target`, `revisions` and `drift`.

use super::table::{cut, table};
use super::units::{counts, name_of, seconds, setting, when};
use super::{Context, Ended};
use crate::cli::terminal::width;
use albireo_hub::http::{OutcomeLine, Revision, Revisions};
use albireo_hub::tuning::desired::NodeSetting;
use albireo_hub::tuning::outcome::Outcome;
use albireo_hub::tuning::tuner::Drift;
use albireo_wire::{DesiredSetting, Threshold};
use anyhow::ensure;
use serde::Serialize;
use serde_json::{Value, json};

/// The nodes to give a setting, and how long they are waited for: the request without its setting.
#[derive(Debug, clap::Args, Serialize)]
pub(super) struct GiveArguments {
    /// The nodes to set; may be given several times.
    #[arg(long, required = true, value_name = "SELECTOR")]
    select: Vec<String>,
    /// Only report which nodes would change.
    #[arg(long)]
    dry_run: bool,
    /// The reason, which is kept in the history.
    #[arg(long, default_value = "")]
    why: String,
    /// How long to wait for the nodes: 10s, 5m.
    #[arg(long = "wait", value_name = "WAIT", default_value = "10s", value_parser = seconds)]
    wait_s: f64,
}

/// Gives the nodes the setting `name` with `value`, and prints each node's outcome as it arrives.
pub(super) async fn give(
    context: &Context,
    name: &str,
    value: Value,
    arguments: GiveArguments,
) -> anyhow::Result<Ended> {
    let number = value.as_f64();
    let path = match number {
        Some(_) => "/api/v1/threshold",
        None => "/api/v1/target",
    };
    let to = match number {
        Some(number) => Some(DesiredSetting::Threshold(Threshold::new(name, number))),
        // The hub refuses what is no target.
        None => serde_json::from_value(json!({ "target": value })).ok(),
    };
    let mut body = serde_json::to_value(arguments)?;
    ensure!(
        body.get(name).is_none(),
        "no policy has a threshold `{name}`"
    );
    body[name] = value;
    let mut last = None;
    let print_and_keep_last = |line: OutcomeLine| {
        if context.json {
            println!("{}", serde_json::to_string(&line)?);
        } else {
            println!("{}", in_words(&line, to.as_ref()));
        }
        if let OutcomeLine::Last(revision) = line {
            last = Some(revision);
        }
        Ok(())
    };
    context.client.put_lines(path, &body, print_and_keep_last).await?;
    Ok(judge(last.as_ref()))
}

/// Formats a line of the hub's answer: the outcome of one node, or at the end the revision and its counts.
fn in_words(line: &OutcomeLine, to: Option<&DesiredSetting>) -> String {
    match line {
        OutcomeLine::Outcome(node) => outcome(node, to),
        OutcomeLine::Last(revision) => match revision.number {
            Some(number) => format!("revision {number}: {}", counts(&revision.counts)),
            None => counts(&revision.counts),
        },
    }
}

/// Formats the outcome of a node as a line.
fn outcome(line: &NodeSetting, to: Option<&DesiredSetting>) -> String {
    let text = format!(
        "{:<24} {:<12} {:>9} -> {:<9} {}",
        line.node,
        name_of(&line.given.outcome),
        known(line.from.as_ref()),
        known(to),
        line.given.detail,
    );
    cut(text.trim_end(), width())
}

/// Formats a setting that may be unknown.
fn known(value: Option<&DesiredSetting>) -> String {
    value.map_or_else(|| "-".to_owned(), setting)
}

fn judge(last: Option<&Revision>) -> Ended {
    // Without a last line the answer is incomplete, and the outcome is unknown.
    let Some(last) = last else {
        return Ended::Failed;
    };
    let has = |outcome| last.counts.contains_key(&outcome);
    if has(Outcome::Refused) || has(Outcome::TimedOut) {
        Ended::Failed
    } else if has(Outcome::Waiting) || has(Outcome::Pending) || has(Outcome::Superseded) {
        Ended::Open
    } else {
        Ended::Well
    }
}

/// Arguments of `albireo fleet revisions`.
#[derive(Debug, clap::Args)]
pub(super) struct RevisionsArguments {
    /// One revision, with every node.
    revision: Option<u64>,
    /// Only those that gave this node a setting.
    #[arg(long)]
    node: Option<String>,
    /// The most to list.
    #[arg(long, default_value_t = 20)]
    limit: u32,
}

pub(super) async fn revisions(
    context: &Context,
    arguments: RevisionsArguments,
) -> anyhow::Result<Ended> {
    if let Some(number) = arguments.revision {
        let path = format!("/api/v1/revisions/{number}");
        let revision: Revision = context.client.get(&path, &[]).await?;
        return context.print(&revision, |revision| {
            let rows = revision.nodes.iter().map(|node| {
                [
                    node.node.clone(),
                    name_of(&node.given.outcome),
                    known(node.from.as_ref()),
                    when(node.given.at_ms),
                    node.given.detail.clone(),
                ]
            });
            let nodes = table("node|outcome|>from|when|detail", rows);
            format!("{}\n{nodes}", list(std::slice::from_ref(revision)))
        });
    }
    let mut query = vec![("limit", arguments.limit.to_string())];
    if let Some(node) = arguments.node {
        query.push(("node", node));
    }
    let found: Revisions = context.client.get("/api/v1/revisions", &query).await?;
    context.print(&found, |found| list(&found.revisions))
}

fn list(revisions: &[Revision]) -> String {
    let rows = revisions.iter().map(|revision| {
        [
            revision.number.map(|number| number.to_string()).unwrap_or_default(),
            when(revision.at_ms),
            revision.who.clone(),
            revision.origin.clone(),
            setting(&revision.setting),
            counts(&revision.counts),
            revision.why.clone(),
        ]
    });
    table(">revision|when|who|by|>to|outcome|why", rows)
}

pub(super) async fn drift(context: &Context) -> anyhow::Result<Ended> {
    let drift: Vec<Drift> = context.client.get("/api/v1/drift", &[]).await?;
    context.print(&drift, |nodes| {
        if nodes.is_empty() {
            return "every node that applied its desired setting still has it\n".to_owned();
        }
        let rows = nodes.iter().map(|node| {
            [
                node.node.clone(),
                when(node.since_ms),
                setting(&node.desired),
                known(node.in_force.as_ref()),
                node.set_back.to_string(),
                node.why.clone().unwrap_or_default(),
            ]
        });
        table("node|since|>desired|>in force|>set back|why", rows)
    })
}
