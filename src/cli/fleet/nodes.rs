//! Runs the commands `ls`, `show`, `forget`, `energy` and `watch`.

use super::table::{cut, printable, table};
use super::units::{self, ago, figure, joined, name_of, seconds, threshold, when};
use super::{Context, Ended};
use crate::cli::terminal::width;
use crate::cli::values::counted;
use albireo_hub::http::{Energy, NodeDetail, NodeList};
use albireo_hub::presence::{NodeView, PresenceState};
use albireo_service::clock::{DAY_MS, unix_milliseconds};
use albireo_wire::{CameraStatus, EnergyQuality, NodeStatus, NodeTarget, check_segment};
use reqwest::Method;
use serde_json::json;
use std::io::IsTerminal;
use std::time::Duration;

/// The number of nodes per page.
const PAGE: usize = 500;
/// From this many seconds on, a period of `energy` begins with a day (UTC).
const WHOLE_DAYS_FROM: f64 = 2.0 * 86_400.0;
/// The number of nodes that `watch` shows.
const SHOWN: usize = 20;
/// The time between two updates of `watch`.
const LOOK: Duration = Duration::from_secs(2);

/// Arguments of `albireo fleet ls`.
#[derive(Debug, clap::Args)]
pub(super) struct ListArguments {
    /// Only nodes in this state: online, degraded, silent or offline.
    #[arg(long)]
    state: Option<String>,
    /// Sort by name, state (offline first), heard (most recent first) or waiting (most waiting reports first).
    #[arg(long, default_value = "name", value_parser = ["name", "state", "heard", "waiting"])]
    sort: String,
    /// The most nodes to list.
    #[arg(long, default_value_t = 1_000)]
    limit: usize,
}

pub(super) async fn forget(context: &Context, nodes: &[String]) -> anyhow::Result<Ended> {
    for node in nodes {
        let path = path_of(node)?;
        context.client.plain(Method::DELETE, &path).await?;
        println!("{node} is forgotten");
    }
    Ok(Ended::Well)
}

/// Arguments of `albireo fleet energy`.
#[derive(Debug, clap::Args)]
pub(super) struct EnergyArguments {
    /// How far back: 7d, 12h; from two days on, the period begins with a day (UTC).
    #[arg(long, default_value = "7d", value_parser = seconds, value_name = "TIME")]
    since: f64,
    /// One line for each node, camera, day, policy or threshold.
    #[arg(long, value_name = "WHAT")]
    by: Option<String>,
    /// Only this node.
    #[arg(long)]
    node: Option<String>,
    /// Sort by group, or by joules (the most energy first).
    #[arg(long, default_value = "group", value_parser = ["group", "joules"])]
    sort: String,
}

/// Fetches the nodes page by page.
pub(super) async fn list(context: &Context, arguments: ListArguments) -> anyhow::Result<Ended> {
    let ListArguments { state, sort, limit } = arguments;
    // The worst state, the most recent status and the most waiting reports come first.
    let is_reversed = sort != "name";
    let mut found: Vec<NodeView> = Vec::new();
    while found.len() < limit {
        let mut query = vec![
            ("limit", PAGE.min(limit - found.len()).to_string()),
            ("offset", found.len().to_string()),
            ("down", is_reversed.to_string()),
            ("sort", sort.clone()),
        ];
        if let Some(state) = &state {
            query.push(("state", state.clone()));
        }
        let page: NodeList = context.client.get("/api/v1/nodes", &query).await?;
        let is_empty = page.nodes.is_empty();
        found.extend(page.nodes);
        if is_empty || page.total <= found.len() {
            break;
        }
    }
    context.print(&json!({ "nodes": found }), |_| list_of(&found))
}

/// Returns the node's target or, without one, the value in force if all cameras have the same.
fn value(status: &NodeStatus) -> String {
    if let Some(target) = &status.target {
        return format!("hold {}", target.target);
    }
    let mut values = status.cameras.iter().map(camera_value);
    match values.next() {
        None => "-".to_owned(),
        Some(first) if values.all(|value| value == first) => first,
        Some(_) => "differ".to_owned(),
    }
}

fn camera_value(camera: &CameraStatus) -> String {
    camera.threshold.as_ref().map_or("-".to_owned(), threshold)
}

/// Formats the labels of a node in one line.
fn labels(status: &NodeStatus) -> String {
    let labels: Vec<_> =
        status.labels.iter().map(|(key, value)| format!("{key}={value}")).collect();
    labels.join(" ")
}

fn list_of(nodes: &[NodeView]) -> String {
    let dash = || "-".to_owned();
    let rows = nodes.iter().map(|node| {
        let status = node.status.as_deref();
        [
            node.node.clone(),
            node.state.to_string(),
            ago(node.since_ms),
            status.map_or_else(dash, value),
            status.map_or_else(dash, |status| status.policy.clone()),
            node.waiting.to_string(),
            node.revision.to_string(),
            cut(&status.map(labels).unwrap_or_default(), 30),
            node.why.clone(),
        ]
    });
    let headings = "node|state|since|>value|policy|>waiting|>change|labels|why";
    table(headings, rows)
}

/// The path of a node in the hub's API. A name that is no part of a path is refused: `cam-7?old` would be a query to cam-7. One
/// that no node may have any more can still be forgotten.
fn path_of(node: &str) -> anyhow::Result<String> {
    check_segment("node name", node)?;
    let is_only_dots = node.bytes().all(|byte| byte == b'.');
    anyhow::ensure!(!is_only_dots, "node name `{node}`: it is only dots");
    Ok(format!("/api/v1/nodes/{node}"))
}

pub(super) async fn show(context: &Context, node: &str) -> anyhow::Result<Ended> {
    let detail: NodeDetail = context.client.get(&path_of(node)?, &[]).await?;
    context.print(&detail, |detail| facts(&detail.node))
}

/// Formats what is known of a node, a line for each fact.
fn facts(node: &NodeView) -> String {
    let since = ago(node.since_ms);
    let state = match node.why.as_str() {
        "" => format!("{} for {since}", node.state),
        why => format!("{} for {since}: {why}", node.state),
    };
    let mut lines = vec![("node", node.node.clone()), ("state", state)];
    if let Some(heard_ms) = node.heard_ms {
        lines.push(("heard", when(heard_ms)));
    }
    let status = node.status.as_deref();
    if let Some(status) = status {
        let provider = status.provider.as_deref().unwrap_or("no provider yet");
        let quality = name_of(&status.power_quality);
        lines.extend([
            ("labels", labels(status)),
            ("version", status.version.clone()),
            ("policy", status.policy.clone()),
            ("model", format!("{} on {provider}", status.model)),
            ("power", format!("{}, {quality}", status.power_source)),
        ]);
    }
    lines.push(("revision", node.revision.to_string()));
    lines.push(("waiting", counted(node.waiting, "report", "reports")));
    if let Some(status) = status {
        if let Some(refused) = &status.refused {
            let text = format!("revision {}: {}", refused.revision, refused.reason);
            lines.push(("refused", text));
        }
        match (&status.target, &status.target_off) {
            (Some(report), _) => lines.push(("target", target_words(report))),
            (None, Some(off)) => lines.push(("target", format!("none: {off}"))),
            (None, None) => (),
        }
        for camera in &status.cameras {
            let source = match status.target {
                Some(_) => "moved by the target".to_owned(),
                None => format!("from {}", name_of(&camera.threshold_source)),
            };
            let name = &camera.name;
            let state = name_of(&camera.state);
            let value = camera_value(camera);
            lines.push(("camera", format!("{name}: {state}, {value} ({source})")));
        }
    }
    let mut text = String::new();
    for (name, value) in lines {
        if !value.is_empty() {
            let line = format!("{name:<12} {}", printable(&value));
            text += &cut(&line, width());
            text.push('\n');
        }
    }
    text
}

/// Formats the target of a node with its last reported state.
fn target_words(report: &NodeTarget) -> String {
    let actual = report.actual.map_or_else(String::new, |now| format!(", now {}", figure(now)));
    let status = report.status.map_or_else(|| "begins".to_owned(), |status| name_of(&status));
    let source = name_of(&report.source);
    format!("{}{actual}, {status} (from {source})", report.target)
}

pub(super) async fn energy(context: &Context, arguments: EnergyArguments) -> anyhow::Result<Ended> {
    let start_ms = unix_milliseconds() - (arguments.since * 1e3) as i64;
    // The hub keeps sums of whole days, which are enough for a long time.
    let since_ms = if arguments.since >= WHOLE_DAYS_FROM {
        start_ms.div_euclid(DAY_MS) * DAY_MS
    } else {
        start_ms
    };
    let mut query = vec![("since_ms", since_ms.to_string()), ("sort", arguments.sort)];
    if let Some(by) = arguments.by {
        query.push(("by", by));
    }
    if let Some(node) = arguments.node {
        query.push(("node", node));
    }
    let energy: Energy = context.client.get("/api/v1/energy", &query).await?;
    context.print(&energy, sums)
}

/// Formats one line for each group and quality; different qualities are never added.
fn sums(energy: &Energy) -> String {
    if energy.groups.is_empty() {
        return "there are no clips in that time\n".to_owned();
    }
    let rows = energy.groups.iter().map(|group| {
        let joules = |value: f64| match group.quality {
            EnergyQuality::Unavailable => "-".to_owned(),
            _ => figure(value),
        };
        let name = match group.group.as_str() {
            "" => "all",
            name => name,
        };
        let recall = group.audit.as_ref().and_then(|audit| audit.recall);
        [
            name.to_owned(),
            name_of(&group.quality),
            group.clips.to_string(),
            joules(group.joules),
            joules(group.joules / group.clips.max(1) as f64),
            figure(group.skip_rate),
            group.avoided_calls.to_string(),
            // A rate with its interval.
            recall.map_or("-".to_owned(), |recall| {
                format!("{:.3} ({:.2}-{:.2})", recall.rate, recall.low, recall.high)
            }),
            joules(group.saved_joules_estimated),
        ]
    });
    let headings =
        "group|energy|>clips|>joules|>J/clip|>skip rate|>avoided|>recall|>saved J (est.)";
    table(headings, rows)
}

pub(super) async fn watch(context: &Context, most: Option<u64>) -> anyhow::Result<Ended> {
    let mut looks = 0;
    loop {
        // The hub counts the nodes and lists those with problems first, so one page is enough for any fleet.
        let query = [
            ("sort", "state".to_owned()),
            ("down", "true".to_owned()),
            ("limit", SHOWN.to_string()),
        ];
        let page: NodeList = context.client.get("/api/v1/nodes", &query).await?;
        if context.json {
            println!("{}", serde_json::to_string(&page)?);
        } else {
            if std::io::stdout().is_terminal() {
                // Clear and go to the upper left corner.
                print!("\x1b[2J\x1b[H");
            }
            print!("{}", overview(&page));
        }
        looks += 1;
        if most.is_some_and(|most| looks >= most) {
            return Ok(Ended::Well);
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Formats the number of nodes in each state, then the nodes with problems, or else the first ones.
fn overview(page: &NodeList) -> String {
    let counts = page.counts.iter().map(|(state, nodes)| format!("{nodes} {state}"));
    let summary = format!(
        "{}: {}; waiting: {}",
        units::nodes(page.counts.values().sum()),
        joined(counts),
        counted(page.waiting, "report", "reports")
    );
    let unwell = page.nodes.partition_point(|node| node.state != PresenceState::Online);
    let shown = if unwell > 0 {
        &page.nodes[..unwell]
    } else {
        &page.nodes
    };
    format!("{}\n\n{}", cut(&summary, width()), list_of(shown))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_is_no_part_of_a_path_is_refused_and_one_that_no_node_may_have_now_is_not() {
        assert_eq!(path_of("cam-7").unwrap(), "/api/v1/nodes/cam-7");
        assert_eq!(path_of("all").unwrap(), "/api/v1/nodes/all");
        for name in ["cam-7?old", "cam-7#old", "../cam-7", "..", ""] {
            let refused = path_of(name).unwrap_err().to_string();
            assert!(refused.contains("node name"), "{refused}");
        }
    }
}
