//! `ls`, `show`, `energy`, `watch`.

use super::table::{Table, WIDTH, cut};
use super::units::{
    ago, figure, items, now_ms, seconds, setting, target_words, text_of, threshold,
};
use super::{Context, Ended};
use anyhow::anyhow;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Duration;

/// Nodes of one page.
const PAGE: usize = 500;
/// Most nodes that are listed.
const MOST: usize = 200_000;
/// From so many seconds on, a time of `energy` begins with a day (UTC).
const WHOLE_DAYS_FROM: f64 = 2.0 * 86_400.0;
const DAY_MS: i64 = 86_400_000;
/// Nodes that `watch` shows, and the largest fleet whose values it counts.
const SHOWN: usize = 20;
const MOST_VALUES: u64 = 5_000;
/// Time between two looks of `watch`.
const LOOK: Duration = Duration::from_secs(2);

/// Arguments of `albireo fleet ls`.
#[derive(Debug, clap::Args)]
pub(super) struct ListArguments {
    /// Only nodes in this state: online, degraded, silent or offline.
    #[arg(long)]
    state: Option<String>,
    /// By name, state (offline first), heard (the last heard first), waiting (the most waiting reports first).
    #[arg(long, default_value = "name", value_parser = ["name", "state", "heard", "waiting"])]
    sort: String,
    /// How many at most.
    #[arg(long, default_value_t = 1_000)]
    limit: usize,
}

/// Arguments of `albireo fleet show`.
#[derive(Debug, clap::Args)]
pub(super) struct ShowArguments {
    /// Its name.
    node: String,
}

pub(super) async fn forget(context: &Context, nodes: &[String]) -> anyhow::Result<Ended> {
    for node in nodes {
        context
            .client
            .delete(&format!("/api/v1/nodes/{node}"))
            .await?;
        println!("{node} is forgotten");
    }
    Ok(Ended::Well)
}

/// Arguments of `albireo fleet energy`.
#[derive(Debug, clap::Args)]
pub(super) struct EnergyArguments {
    /// From when on: 7d, 12h; from two days on it begins with a day (UTC).
    #[arg(long, default_value = "7d", value_parser = seconds, value_name = "TIME")]
    since: f64,
    /// One line for each node, camera, day, policy or knob.
    #[arg(long, value_name = "WHAT")]
    by: Option<String>,
    /// Only this node.
    #[arg(long)]
    node: Option<String>,
    /// By group, or joules: the most energy first.
    #[arg(long, default_value = "group", value_parser = ["group", "joules"])]
    sort: String,
}

/// Arguments of `albireo fleet watch`.
#[derive(Debug, clap::Args)]
pub(super) struct WatchArguments {
    /// Stop after so many looks.
    #[arg(long, value_name = "N")]
    looks: Option<u64>,
}

/// All nodes, page by page.
async fn nodes(
    context: &Context,
    state: Option<&str>,
    sort: &str,
    limit: usize,
) -> anyhow::Result<Vec<Value>> {
    let mut found: Vec<Value> = Vec::new();
    while found.len() < limit.min(MOST) {
        let mut query = vec![("limit", PAGE.min(limit - found.len()).to_string())];
        query.push(("sort", sort.to_owned()));
        // The worst, the last heard and the most waiting first.
        query.push(("down", (sort != "name").to_string()));
        query.push(("offset", found.len().to_string()));
        query.extend(state.map(|state| ("state", state.to_owned())));
        let page = context.client.get("/api/v1/nodes", &query).await?;
        let nodes = page["nodes"]
            .as_array()
            .ok_or_else(|| anyhow!("the hub gives no list of nodes"))?;
        found.extend(nodes.iter().cloned());
        if nodes.is_empty() || page["total"].as_u64() <= Some(found.len() as u64) {
            break;
        }
    }
    Ok(found)
}

pub(super) async fn list(context: &Context, arguments: ListArguments) -> anyhow::Result<Ended> {
    let found = nodes(
        context,
        arguments.state.as_deref(),
        &arguments.sort,
        arguments.limit,
    )
    .await?;
    context.print(&json!({ "nodes": found }), |_| table(&found))?;
    Ok(Ended::Well)
}

/// The target that is held; else the value in force, as far as all cameras have the same.
fn value(node: &Value) -> String {
    if node["status"]["target"].is_object() {
        return setting(&node["status"]["target"]);
    }
    let cameras = items(&node["status"]["cameras"]);
    match cameras {
        [] => "-".to_owned(),
        [first, rest @ ..]
            if rest
                .iter()
                .all(|camera| threshold(camera) == threshold(first)) =>
        {
            threshold(first)
        }
        _ => "differ".to_owned(),
    }
}

/// The labels of a node, in one line.
fn labels(node: &Value) -> String {
    let labels = node["status"]["labels"].as_object().into_iter().flatten();
    let labels: Vec<String> = labels
        .map(|(key, value)| format!("{key}={}", value.as_str().unwrap_or_default()))
        .collect();
    labels.join(" ")
}

fn table(nodes: &[Value]) -> String {
    let mut table = Table::new(&[
        "node", "state", "since", ">value", "policy", ">waiting", ">change", "labels", "why",
    ]);
    for node in nodes {
        table.row([
            text_of(&node["node"]),
            text_of(&node["state"]),
            ago(node["since_ms"].as_i64().unwrap_or(0)),
            value(node),
            node["status"]["policy"].as_str().unwrap_or("-").to_owned(),
            node["waiting"].to_string(),
            node["revision"].to_string(),
            cut(&labels(node), 30),
            text_of(&node["why"]),
        ]);
    }
    table.to_string()
}

pub(super) async fn show(context: &Context, arguments: ShowArguments) -> anyhow::Result<Ended> {
    let node = context
        .client
        .get(&format!("/api/v1/nodes/{}", arguments.node), &[])
        .await?;
    context.print(&node, |node| {
        let status = &node["status"];
        let mut text = String::new();
        let mut line = |name: &str, value: String| {
            if !value.is_empty() {
                let _ = writeln!(text, "{}", cut(&format!("{name:<12} {value}"), WIDTH));
            }
        };
        let said = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        line("node", said(&node["node"]));
        let why = said(&node["why"]);
        let since = ago(node["since_ms"].as_i64().unwrap_or(0));
        line(
            "state",
            match why.is_empty() {
                true => format!("{} for {since}", said(&node["state"])),
                false => format!("{} for {since}: {why}", said(&node["state"])),
            },
        );
        line(
            "heard",
            node["heard_ms"]
                .as_i64()
                .map(|at| format!("{} ago", ago(at)))
                .unwrap_or_default(),
        );
        line("labels", labels(node));
        line("version", said(&status["version"]));
        line("policy", said(&status["policy"]));
        line(
            "model",
            format!(
                "{} on {}",
                said(&status["model"]),
                said(&status["provider"])
            ),
        );
        line(
            "power",
            format!(
                "{}, {}",
                said(&status["power_source"]),
                said(&status["power_quality"])
            ),
        );
        line("revision", node["revision"].to_string());
        line("waiting", format!("{} reports", node["waiting"]));
        if let Some(refused) = status["refused"].as_object() {
            line(
                "refused",
                format!(
                    "revision {}: {}",
                    refused["revision"],
                    said(&refused["reason"])
                ),
            );
        }
        line("target", target(status));
        for camera in items(&status["cameras"]) {
            let source = match status["target"].is_object() {
                true => "moved by the target".to_owned(),
                false => format!("from {}", said(&camera["threshold_source"])),
            };
            line(
                "camera",
                format!(
                    "{}: {}, {} ({source})",
                    said(&camera["name"]),
                    said(&camera["state"]),
                    threshold(camera)
                ),
            );
        }
        text
    })?;
    Ok(Ended::Well)
}

/// The target of a node with its last reported status; else why it has none any more.
fn target(status: &Value) -> String {
    let held = &status["target"];
    let said = |value: &Value| value.as_str().unwrap_or_default().replace('_', " ");
    match (held.is_object(), status["target_off"].as_str()) {
        (true, _) => {
            let actual =
                (held["actual"].as_f64()).map(|actual| format!(", now {}", figure(actual)));
            format!(
                "{}{}, {} (from {})",
                target_words(&held["target"]),
                actual.unwrap_or_default(),
                held["status"]
                    .as_str()
                    .map_or("begins".to_owned(), |_| said(&held["status"])),
                said(&held["source"]),
            )
        }
        (false, Some(off)) => format!("none: {off}"),
        (false, None) => String::new(),
    }
}

pub(super) async fn energy(context: &Context, arguments: EnergyArguments) -> anyhow::Result<Ended> {
    let from = now_ms() - (arguments.since * 1e3) as i64;
    // The hub keeps sums of whole days, which are enough for a long time.
    let from = match arguments.since >= WHOLE_DAYS_FROM {
        true => from.div_euclid(DAY_MS) * DAY_MS,
        false => from,
    };
    let mut query = vec![("since_ms", from.to_string()), ("sort", arguments.sort)];
    query.extend(arguments.by.map(|by| ("by", by)));
    query.extend(arguments.node.map(|node| ("node", node)));
    let energy = context.client.get("/api/v1/energy", &query).await?;
    context.print(&energy, sums)?;
    Ok(Ended::Well)
}

/// One line for each group and quality; the quality is never summed over.
fn sums(answer: &Value) -> String {
    let groups = items(&answer["groups"]);
    if groups.is_empty() {
        return "no clips in that time\n".to_owned();
    }
    let mut table = Table::new(&[
        "group",
        "energy",
        ">clips",
        ">joules",
        ">J/clip",
        ">skip rate",
        ">calls avoided",
        ">recall of the detector",
        ">saved J (estimate)",
    ]);
    for group in groups {
        let number = |name: &str| group[name].as_f64().unwrap_or(0.0);
        let measured = group["quality"] != "unavailable";
        let joules = |value: f64| {
            if measured {
                figure(value)
            } else {
                "-".to_owned()
            }
        };
        table.row([
            group["group"]
                .as_str()
                .filter(|name| !name.is_empty())
                .unwrap_or("all")
                .to_owned(),
            text_of(&group["quality"]),
            group["clips"].to_string(),
            joules(number("joules")),
            joules(number("joules") / number("clips").max(1.0)),
            figure(number("skip_rate")),
            group["avoided_calls"].to_string(),
            recall(&group["audit"]["all"]["recall"]),
            joules(number("saved_joules_estimated")),
        ]);
    }
    table.to_string()
}

/// A rate with the interval that it is known to: `0.912 (0.88-0.94)`.
fn recall(found: &Value) -> String {
    let number = |name: &str| found[name].as_f64();
    match (number("rate"), number("low"), number("high")) {
        (Some(rate), Some(low), Some(high)) => format!("{rate:.3} ({low:.2}-{high:.2})"),
        _ => "-".to_owned(),
    }
}

pub(super) async fn watch(context: &Context, arguments: WatchArguments) -> anyhow::Result<Ended> {
    let mut looks = 0;
    loop {
        // The hub counts, and puts those that are not well first: a page is enough however large the fleet is.
        let query = [
            ("sort", "state".to_owned()),
            ("down", "true".to_owned()),
            ("limit", SHOWN.to_string()),
        ];
        let page = context.client.get("/api/v1/nodes", &query).await?;
        let known: u64 = page["counts"]
            .as_object()
            .into_iter()
            .flatten()
            .filter_map(|(_, n)| n.as_u64())
            .sum();
        let found = if known <= MOST_VALUES {
            Some(nodes(context, None, "name", MOST).await?)
        } else {
            None
        };
        if context.json {
            println!("{page}");
        } else {
            if context.terminal {
                // Clear and go to the upper left corner.
                print!("\x1b[2J\x1b[H");
            }
            print!("{}", overview(&page, known, found.as_deref()));
        }
        looks += 1;
        if arguments.looks.is_some_and(|most| looks >= most) {
            return Ok(Ended::Well);
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// How many nodes are in which state and, where all were asked for, which values they have; then those that are not
/// well, or the first ones.
fn overview(page: &Value, known: u64, nodes: Option<&[Value]>) -> String {
    let counts = page["counts"].as_object().into_iter().flatten();
    let states: Vec<String> = counts.map(|(state, n)| format!("{n} {state}")).collect();
    let mut text = format!("{known} nodes: {}", states.join(", "));
    if let Some(nodes) = nodes {
        let waiting: u64 = nodes.iter().filter_map(|n| n["waiting"].as_u64()).sum();
        text += &format!("; {waiting} reports wait");
    }
    let mut text = cut(&text, WIDTH) + "\n";
    if let Some(nodes) = nodes {
        let mut values: BTreeMap<String, usize> = BTreeMap::new();
        for node in nodes {
            *values.entry(value(node)).or_insert(0) += 1;
        }
        let values: Vec<String> = values
            .iter()
            .map(|(at, n)| format!("{n} at {at}"))
            .collect();
        text += &(cut(&format!("values: {}", values.join(", ")), WIDTH) + "\n");
    }
    text.push('\n');
    let shown = items(&page["nodes"]);
    let unwell = shown.iter().take_while(|node| node["state"] != "online");
    let unwell = unwell.count();
    text + &table(if unwell > 0 { &shown[..unwell] } else { shown })
}
