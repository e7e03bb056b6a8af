//! The nodes of the fleet.

use super::{HubView, query, unavailable};
use crate::presence::{NodeView, Order, PresenceState};
use crate::store::InstanceView;
use albireo_service::http::{Caller, Problem};
use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Path, Query, State};
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Most nodes of one page.
const MOST: usize = 1000;

/// Which nodes.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
    /// Of this state only: `online`, `degraded`, `silent`, `offline`.
    state: Option<String>,
    /// With this text in the name.
    search: Option<String>,
    /// `name`, or: `state` (offline first), `heard` (the last heard first), `-heard` (the longest not heard first),
    /// `waiting` (the most waiting reports first), `joules` (the most energy of today first).
    sort: Option<String>,
    /// `next` of the page before.
    cursor: Option<String>,
    /// At most so many, 100 by default, 1000 at most.
    limit: Option<usize>,
}

/// A page of nodes.
#[derive(Serialize, ToSchema)]
pub(super) struct NodePage {
    /// Nodes of the fleet by state, whatever is selected.
    counts: Counts,
    nodes: Vec<NodeView>,
    /// What to give as `cursor` for the next page; absent on the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<String>,
}

/// Nodes by state.
#[derive(Serialize, ToSchema)]
pub(super) struct Counts {
    pub(super) online: u64,
    pub(super) degraded: u64,
    pub(super) silent: u64,
    pub(super) offline: u64,
}

/// A node with its instances.
#[derive(Serialize, ToSchema)]
pub(super) struct NodeDetail {
    #[serde(flatten)]
    node: NodeView,
    /// Its instances, the last heard first: more than one after its state was made anew, or when two nodes have this
    /// name.
    instances: Vec<InstanceView>,
}

/// The nodes of the fleet, page by page
///
/// `curl 'http://127.0.0.1:8090/api/v1/nodes?state=degraded&limit=20'`
#[utoipa::path(
    get, operation_id = "list_nodes", path = "/api/v1/nodes", tag = "nodes", params(Selection),
    responses(
        (status = 200, body = NodePage),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list(
    State(view): State<HubView>,
    selection: Result<Query<Selection>, QueryRejection>,
) -> Result<Json<NodePage>, Problem> {
    let selection = query(selection)?;
    let state = match selection.state.as_deref() {
        None => None,
        Some(name) => match PresenceState::named(name) {
            Some(state) => Some(state),
            None => {
                let known = PresenceState::ALL.map(PresenceState::as_str);
                let detail = format!(
                    "there is no state `{name}`; there are: {}",
                    known.join(", ")
                );
                return Err(Problem::new(StatusCode::BAD_REQUEST, detail).allowing(known));
            }
        },
    };
    let limit = selection.limit.unwrap_or(100).clamp(1, MOST);
    let search = selection.search.unwrap_or_default();
    let wanted = |name: &str, is| state.is_none_or(|state| state == is) && name.contains(&search);
    let cursor = selection.cursor.as_deref();
    let (nodes, next) = match order(selection.sort.as_deref())? {
        None => {
            let mut nodes = view.fleet.list(cursor, limit + 1, wanted);
            let more = nodes.len() > limit;
            nodes.truncate(limit);
            let last = nodes.last().map(|node| node.node.clone());
            (nodes, last.filter(|_| more))
        }
        Some(order) => {
            let after = cursor.map(place).transpose()?;
            let mut nodes = view.fleet.sorted(order, after, limit + 1, wanted);
            let more = nodes.len() > limit;
            nodes.truncate(limit);
            let last = nodes
                .last()
                .map(|(key, node)| format!("{key}:{}", node.node));
            let nodes = nodes.into_iter().map(|(_, node)| node).collect();
            (nodes, last.filter(|_| more))
        }
    };
    let [online, degraded, silent, offline] = view.fleet.by_state();
    let counts = Counts {
        online,
        degraded,
        silent,
        offline,
    };
    Ok(Json(NodePage {
        counts,
        nodes,
        next,
    }))
}

/// The order asked for; `None` is that of the names.
fn order(sort: Option<&str>) -> Result<Option<Order>, Problem> {
    const KNOWN: [&str; 6] = ["name", "state", "heard", "-heard", "waiting", "joules"];
    Ok(match sort {
        None | Some("name") => None,
        Some("state") => Some(Order::WorstFirst),
        Some("heard") => Some(Order::LastHeard),
        Some("-heard") => Some(Order::LongestUnheard),
        Some("waiting") => Some(Order::MostWaiting),
        Some("joules") => Some(Order::MostJoules),
        Some(other) => {
            let detail = format!(
                "nodes cannot be sorted by `{other}`, but by: {}",
                KNOWN.join(", ")
            );
            return Err(Problem::new(StatusCode::BAD_REQUEST, detail).allowing(KNOWN));
        }
    })
}

/// Key and name of the last node of a page.
fn place(cursor: &str) -> Result<(i64, &str), Problem> {
    let place = cursor
        .split_once(':')
        .and_then(|(key, name)| Some((key.parse().ok()?, name)));
    place.ok_or_else(|| {
        let detail = "`cursor` is not the `next` of a page in this order";
        Problem::new(StatusCode::BAD_REQUEST, detail)
    })
}

/// One node with its instances
///
/// `curl http://127.0.0.1:8090/api/v1/nodes/car-7`
#[utoipa::path(
    get, operation_id = "node", path = "/api/v1/nodes/{node}", tag = "nodes", params(("node" = String, Path, description = "Its name")),
    responses(
        (status = 200, body = NodeDetail),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn one(
    State(view): State<HubView>,
    Path(node): Path<String>,
) -> Result<Json<NodeDetail>, Problem> {
    let instances = view
        .store()?
        .instances(&node)
        .await
        .map_err(|error| unavailable(&error))?;
    let known = view.fleet.view(&node).ok_or_else(|| unknown(&node))?;
    Ok(Json(NodeDetail {
        node: known,
        instances,
    }))
}

fn unknown(node: &str) -> Problem {
    let detail = format!("no node `{node}` was ever heard; /api/v1/nodes lists those that were");
    Problem::new(StatusCode::NOT_FOUND, detail)
}

/// Forget a node that is gone
///
/// It leaves the lists, and what is desired of it is dropped; its clips, sums and history stay. A node that is online or degraded, or takes
/// part in a rollout or trial, is not forgotten. One that comes back is a new node.
///
/// `curl -X DELETE http://127.0.0.1:8090/api/v1/nodes/car-7`
#[utoipa::path(
    delete, operation_id = "forget_node", path = "/api/v1/nodes/{node}", tag = "nodes", params(("node" = String, Path, description = "Its name")),
    responses(
        (status = 204, description = "It is forgotten."),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn forget(
    State(view): State<HubView>,
    Extension(caller): Extension<Caller>,
    Path(node): Path<String>,
) -> Result<StatusCode, Problem> {
    let known = view.fleet.view(&node).ok_or_else(|| unknown(&node))?;
    let heard = || {
        let detail = format!("`{node}` is heard and would be back at once: stop it first");
        Problem::new(StatusCode::CONFLICT, detail)
    };
    if matches!(known.state, PresenceState::Online | PresenceState::Degraded) {
        return Err(heard());
    }
    view.tuner()?.forget(&node, &caller.name).await?;
    if !view.fleet.forget(&node) {
        return Err(heard());
    }
    Ok(StatusCode::NO_CONTENT)
}
