//! Lists the nodes, shows one node, and forgets one. The hub sorts, filters and pages the list, so that a client holds
//! only what it shows.

use super::body::unusable;
use crate::hub::Hub;
use crate::ingest::ReportCounts;
use crate::presence::{NodeView, PresenceState};
use crate::tuning::selector::Selector;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::{Caller, Problem, within};
use axum::Json;
use axum::extract::{Extension, Path, Query, State};
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use utoipa::{IntoParams, ToSchema};

/// Most nodes per answer.
const MOST: usize = 1000;

/// The sort order of rows; equal rows are in the order of their names.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum NodeSort {
    /// Name.
    #[default]
    Name,
    /// State: online, degraded, silent, offline.
    State,
    /// Time in that state, the longest first.
    Since,
    /// Time of the last status, the oldest first.
    Heard,
    /// Reports that wait in its outbox, the fewest first.
    Waiting,
    /// Energy of today (UTC), the least first; by the larger of measured and estimated, which are never added.
    Joules,
}

/// Selects and sorts nodes.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct NodeSelection {
    /// Only nodes in these states, separated by commas: `degraded,silent`.
    state: Option<String>,
    /// Only nodes with this text in the name.
    search: Option<String>,
    /// Only nodes that match these names, globs and labels, separated by commas: `cam-*,region=north`.
    select: Option<String>,
    /// The sort order.
    #[serde(default)]
    #[param(inline)]
    sort: NodeSort,
    /// Reverses the order.
    #[serde(default)]
    down: bool,
    /// The number of rows to skip.
    #[serde(default)]
    offset: usize,
    /// Maximum number, up to 1000; 100 by default; 0 for the counts alone.
    limit: Option<usize>,
}

/// A page of nodes.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct NodeList {
    /// The number of nodes in the whole fleet, by state.
    pub counts: BTreeMap<PresenceState, u64>,
    /// Reports that wait in the outboxes of the whole fleet.
    pub waiting: u64,
    /// The number of selected rows, on all pages.
    pub total: usize,
    /// The number of rows before this page.
    pub offset: usize,
    /// The rows.
    pub nodes: Vec<NodeView>,
}

/// The states in a list that is separated by commas.
fn states_in(list: &str) -> Result<Vec<PresenceState>, Problem> {
    let mut states = Vec::new();
    for name in list.split(',').filter(|name| !name.is_empty()) {
        let Some(state) = PresenceState::named(name) else {
            let known = PresenceState::ALL.map(PresenceState::name);
            let detail = format!(
                "there is no state `{name}`; there are: {}",
                known.join(", ")
            );
            return Err(unusable(detail).allowing(known));
        };
        states.push(state);
    }
    Ok(states)
}

/// The nodes of the fleet
///
/// `curl 'http://127.0.0.1:8090/api/v1/nodes?state=degraded,silent&select=region=north&sort=waiting&down=true'`
#[utoipa::path(
    get, operation_id = "list_nodes", path = "/api/v1/nodes", tag = "nodes", params(NodeSelection),
    responses((status = 200, body = NodeList))
)]
pub(super) async fn list(
    State(hub): State<Hub>,
    Query(selection): Query<NodeSelection>,
) -> Result<Json<NodeList>, Problem> {
    let wanted = states_in(selection.state.as_deref().unwrap_or_default())?;
    let select = match &selection.select {
        Some(text) if !text.trim().is_empty() => {
            let selector = text.parse::<Selector>();
            Some(selector.map_err(|error| unusable(error.to_string()))?)
        }
        _ => None,
    };
    let search = selection.search.unwrap_or_default();

    let mut waiting: u64 = 0;
    let mut found = Vec::new();
    hub.fleet.each(|node| {
        // Any node may claim any number.
        waiting = waiting.saturating_add(node.waiting);
        let has_state = wanted.is_empty() || wanted.contains(&node.state);
        let is_selected = match &select {
            Some(selector) => selector.selects(&node.node, node.labels()),
            None => true,
        };
        if has_state && is_selected && node.node.contains(&search) {
            let sort_key = match selection.sort {
                NodeSort::Name => found.len() as i64,
                NodeSort::State => node.state as i64,
                NodeSort::Since => node.since_ms,
                NodeSort::Heard => node.heard_ms.unwrap_or(i64::MIN),
                NodeSort::Joules => node.today.largest_uj(),
                NodeSort::Waiting => i64::try_from(node.waiting).unwrap_or(i64::MAX),
            };
            found.push(FoundNode {
                sort_key,
                name: node.node.clone(),
            });
        }
    });
    // The nodes are in the order of their names, which the sort keeps among equal ones.
    if selection.down {
        found.sort_by_key(|node| Reverse(node.sort_key));
    } else {
        found.sort_by_key(|node| node.sort_key);
    }
    let limit = within("limit", selection.limit.unwrap_or(100), 0..=MOST)?;
    let nodes = found.iter().skip(selection.offset).take(limit);
    Ok(Json(NodeList {
        counts: hub.fleet.by_state(),
        waiting,
        total: found.len(),
        offset: selection.offset,
        nodes: nodes.filter_map(|node| hub.fleet.view(&node.name)).collect(),
    }))
}

/// A node that is selected: only those on the page are read in full.
struct FoundNode {
    sort_key: i64,
    name: String,
}

/// A node with the counts of its reports.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct NodeDetail {
    /// The node.
    #[serde(flatten)]
    pub node: NodeView,
    /// The counts of its reports; absent if none was received.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reports: Option<ReportCounts>,
}

/// One node with the counts of its reports
///
/// `curl http://127.0.0.1:8090/api/v1/nodes/car-7`
#[utoipa::path(
    get, operation_id = "node", path = "/api/v1/nodes/{node}", tag = "nodes", params(("node" = String, Path, description = "Its name")),
    responses((status = 200, body = NodeDetail))
)]
pub(super) async fn one(
    State(hub): State<Hub>,
    Path(node): Path<String>,
) -> Result<Json<NodeDetail>, Problem> {
    let reports = hub.store()?.report_counts(&node).await?;
    let known = hub.fleet.view(&node).ok_or_else(|| unknown(&node))?;
    Ok(Json(NodeDetail {
        node: known,
        reports,
    }))
}

pub(super) fn unknown(node: &str) -> Problem {
    let detail = format!("there is no node `{node}`; /api/v1/nodes lists all");
    Problem::new(StatusCode::NOT_FOUND, detail)
}

/// Forgets a node
///
/// It is removed from the lists, and its desired setting is dropped; its clips, sums and history stay. A node that is
/// online or degraded, or takes part in a rollout or trial, is not forgotten. A node that comes back is a new node.
///
/// `curl -X DELETE http://127.0.0.1:8090/api/v1/nodes/car-7`
#[utoipa::path(
    delete, operation_id = "forget_node", path = "/api/v1/nodes/{node}", tag = "nodes", params(("node" = String, Path, description = "Its name")),
    responses((status = 204, description = "It is forgotten."))
)]
pub(super) async fn forget(
    State(hub): State<Hub>,
    Extension(caller): Extension<Caller>,
    Path(node): Path<String>,
) -> Result<StatusCode, Problem> {
    let known = hub.fleet.view(&node);
    // A name that no node may have any more is only in the database.
    if known.is_none() && !hub.store()?.has_node(&node).await? {
        return Err(unknown(&node));
    }
    if known.is_some_and(|known| known.is_reachable()) {
        let detail = format!(
            "`{node}` is online or degraded and would come back immediately: stop it first"
        );
        return Err(Problem::new(StatusCode::CONFLICT, detail));
    }
    let tuner = hub.tuner()?;
    let now = unix_milliseconds();
    tuner.forget(&node, &caller.name, now).await?;
    Ok(StatusCode::NO_CONTENT)
}
