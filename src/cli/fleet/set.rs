//! `set-u`, `set-target`, `changes`, `drift`.

use super::table::Table;
use super::units::{counts, items, seconds, setting, target, text_of, when};
use super::{Context, Ended};
use serde_json::{Value, json};

/// Arguments of `albireo fleet set-u`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The value.
    value: f64,
    /// The knob's name, for nodes under another policy.
    #[arg(long, default_value = "u")]
    knob: String,
    #[command(flatten)]
    order: Order,
}

/// Arguments of `albireo fleet set-target`.
#[derive(Debug, clap::Args)]
pub(super) struct TargetArguments {
    /// What is to be held: skip_rate=0.5, recall=0.9, detector_ms_per_s=300, watts=6 or joules_per_day=500000, also as JSON
    /// ('{"skip_rate": 0.5}'); or off.
    #[arg(value_parser = target)]
    target: Value,
    #[command(flatten)]
    order: Order,
}

/// For whom an order is, and how it is followed.
#[derive(Debug, clap::Args)]
struct Order {
    /// Which nodes; may be given several times.
    #[arg(long, required = true, value_name = "SELECTOR")]
    select: Vec<String>,
    /// Only say who would change.
    #[arg(long)]
    dry_run: bool,
    /// Why; kept in the history.
    #[arg(long, default_value = "")]
    why: String,
    /// How long to wait for the nodes: 10s, 5m.
    #[arg(long, default_value = "10s", value_parser = seconds)]
    wait: f64,
}

pub(super) async fn set(context: &Context, arguments: Arguments) -> anyhow::Result<Ended> {
    let what = (arguments.knob.as_str(), json!(arguments.value));
    order(context, "/api/v1/threshold", what, arguments.order).await
}

pub(super) async fn set_target(
    context: &Context,
    arguments: TargetArguments,
) -> anyhow::Result<Ended> {
    let what = ("target", arguments.target);
    order(context, "/api/v1/target", what, arguments.order).await
}

/// Orders it, and prints each node's outcome as it comes.
async fn order(
    context: &Context,
    path: &str,
    (name, value): (&str, Value),
    order: Order,
) -> anyhow::Result<Ended> {
    let mut body = json!({
        "select": order.select,
        "dry_run": order.dry_run,
        "why": order.why,
        "wait_s": order.wait,
    });
    body[name] = value;
    let mut last = Value::Null;
    let lines = context.client.put_lines(path, &body, |line| {
        if context.json {
            println!("{line}");
        }
        if line.get("counts").is_some() {
            last = line;
        } else if !context.json {
            println!("{}", outcome(&line));
        }
        Ok(())
    });
    lines.await?;
    if !context.json {
        let number = last["revision"]
            .as_u64()
            .map(|n| format!("revision {n}: "))
            .unwrap_or_default();
        println!("{number}{}", counts(&last));
    }
    Ok(judge(&last["counts"]))
}

/// One node's line.
fn outcome(line: &Value) -> String {
    let detail = line["detail"].as_str().unwrap_or_default();
    let text = format!(
        "{:<24} {:<12} {:>9} -> {:<9} {detail}",
        line["node"].as_str().unwrap_or("?"),
        line["outcome"].as_str().unwrap_or("?").replace('_', " "),
        setting(&line["from"]),
        setting(&line["to"]),
    );
    super::table::cut(text.trim_end(), super::table::WIDTH)
}

fn judge(counts: &Value) -> Ended {
    let has = |name: &str| counts[name].as_u64().unwrap_or(0) > 0;
    // Without counts the answer broke off: what became of the nodes is not known.
    if !counts.is_object() || has("refused") || has("timed_out") {
        Ended::Failed
    } else if has("waiting") || has("pending") || has("superseded") {
        Ended::Open
    } else {
        Ended::Well
    }
}

/// Arguments of `albireo fleet changes`.
#[derive(Debug, clap::Args)]
pub(super) struct ChangesArguments {
    /// The change of this revision, with every node.
    revision: Option<u64>,
    /// Only those of this node.
    #[arg(long)]
    node: Option<String>,
    /// How many at most.
    #[arg(long, default_value_t = 20)]
    limit: u32,
}

pub(super) async fn changes(
    context: &Context,
    arguments: ChangesArguments,
) -> anyhow::Result<Ended> {
    if let Some(revision) = arguments.revision {
        let change = context
            .client
            .get(&format!("/api/v1/changes/{revision}"), &[])
            .await?;
        context.print(&change, |change| {
            let mut table = Table::new(&["node", "outcome", ">from", "when", "detail"]);
            for node in items(&change["nodes"]) {
                table.row([
                    text_of(&node["node"]),
                    node["outcome"].as_str().unwrap_or("?").replace('_', " "),
                    setting(&node["from"]),
                    when(&node["at_ms"]),
                    text_of(&node["detail"]),
                ]);
            }
            format!("{}\n{table}", list(&json!({ "changes": [change] })))
        })?;
        return Ok(Ended::Well);
    }
    let mut query = vec![("limit", arguments.limit.to_string())];
    query.extend(arguments.node.map(|node| ("node", node)));
    let changes = context.client.get("/api/v1/changes", &query).await?;
    context.print(&changes, list)?;
    Ok(Ended::Well)
}

fn list(changes: &Value) -> String {
    let mut table = Table::new(&[">revision", "when", "who", "by", ">to", "outcome", "why"]);
    for change in items(&changes["changes"]) {
        let counts = counts(change);
        table.row([
            change["revision"].to_string(),
            when(&change["at_ms"]),
            text_of(&change["who"]),
            text_of(&change["origin"]),
            setting(&change["to"]),
            counts,
            text_of(&change["why"]),
        ]);
    }
    table.to_string()
}

pub(super) async fn drift(context: &Context) -> anyhow::Result<Ended> {
    let drift = context.client.get("/api/v1/drift", &[]).await?;
    context.print(&drift, |drift| {
        let nodes = drift.as_array().map(Vec::as_slice).unwrap_or_default();
        if nodes.is_empty() {
            return "every node that took a desired value still has it\n".to_owned();
        }
        let mut table = Table::new(&["node", "since", ">desired", ">in force", ">set back", "why"]);
        for node in nodes {
            table.row([
                text_of(&node["node"]),
                when(&node["since_ms"]),
                setting(&node["desired"]),
                setting(&node["in_force"]),
                node["set_back"].to_string(),
                text_of(&node["why"]),
            ]);
        }
        table.to_string()
    })?;
    Ok(Ended::Well)
}
