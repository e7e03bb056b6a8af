//! The list of nodes, which the hub sorts, filters and cuts: a client holds only what it shows.

use super::body::unusable;
use super::{HubView, query};
use crate::presence::{NodeView, PresenceState, day_of};
use crate::tuning::selector::Selector;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::Problem;
use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::sync::Arc;
use utoipa::{IntoParams, ToSchema};

/// Most nodes of one answer.
const MOST: usize = 1000;

/// What rows are sorted by; those that are equal, by name.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Order {
    /// Name.
    #[default]
    Name,
    /// State: online, degraded, silent, offline.
    State,
    /// How long it has that state, the longest first.
    Since,
    /// When it was last heard, the longest ago first.
    Heard,
    /// Reports that wait in its outbox, the fewest first.
    Waiting,
    /// Energy of today (UTC), the least first; by the larger of measured and estimated, which are never added.
    Joules,
}

/// Which rows.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
    /// Of these states only, separated by commas: `degraded,silent`.
    state: Option<String>,
    /// With this text in the name.
    search: Option<String>,
    /// Chosen by names, globs and labels, separated by commas: `cam-*,region=north`.
    select: Option<String>,
    /// What they are sorted by.
    #[serde(default)]
    #[param(inline)]
    sort: Order,
    /// The other way round.
    #[serde(default)]
    down: bool,
    /// Rows left out before the first one.
    #[serde(default)]
    offset: usize,
    /// At most this many, 100 by default, 1000 at most.
    limit: Option<usize>,
}

/// Nodes by state.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Counts {
    /// All its parts work.
    pub online: u64,
    /// Something of it is impaired.
    pub degraded: u64,
    /// Nothing was heard for a while.
    pub silent: u64,
    /// It is gone.
    pub offline: u64,
}

/// Nodes of the fleet.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct NodeList {
    /// Nodes of the whole fleet by state.
    pub counts: Counts,
    /// Reports that wait in the outboxes of the whole fleet.
    pub waiting: u64,
    /// Rows there are of this selection.
    pub total: usize,
    /// Place of the first row of this answer among them.
    pub offset: usize,
    /// The rows.
    pub nodes: Vec<NodeView>,
}

struct Row {
    name: Arc<str>,
    /// What it is sorted by.
    key: i64,
}

fn states(text: Option<&str>) -> Result<Vec<PresenceState>, Problem> {
    let names = text.into_iter().flat_map(|text| text.split(','));
    names
        .filter(|name| !name.is_empty())
        .map(|name| {
            PresenceState::named(name).ok_or_else(|| {
                let known = PresenceState::ALL.map(PresenceState::name);
                let detail = format!(
                    "there is no state `{name}`; there are: {}",
                    known.join(", ")
                );
                unusable(detail).allowing(known)
            })
        })
        .collect()
}

fn selector(text: Option<&str>) -> Result<Option<Selector>, Problem> {
    let Some(text) = text.filter(|text| !text.trim().is_empty()) else {
        return Ok(None);
    };
    let terms: Vec<&str> = text.split(',').map(str::trim).collect();
    let selector = Selector::new(&terms).map_err(|error| unusable(error.to_string()))?;
    Ok(Some(selector))
}

/// The nodes of the fleet
///
/// `curl 'http://127.0.0.1:8090/api/v1/nodes?state=degraded,silent&select=region=north&sort=waiting&down=true'`
#[utoipa::path(
    get, operation_id = "list_nodes", path = "/api/v1/nodes", tag = "nodes", params(Selection),
    responses(
        (status = 200, body = NodeList),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list(
    State(view): State<HubView>,
    selection: Result<Query<Selection>, QueryRejection>,
) -> Result<Json<NodeList>, Problem> {
    let selection = query(selection)?;
    let wanted = states(selection.state.as_deref())?;
    let selector = selector(selection.select.as_deref())?;
    let search = selection.search.unwrap_or_default();
    let order = selection.sort;

    let mut waiting = 0;
    let mut found = Vec::new();
    let day = day_of(unix_milliseconds());
    view.fleet.each(|name, node| {
        waiting += node.waiting;
        let is_wanted = (wanted.is_empty() || wanted.contains(&node.state))
            && name.contains(&search)
            && (selector.as_ref()).is_none_or(|it| it.selects(name, node.labels()));
        if !is_wanted {
            return;
        }
        let place = PresenceState::ALL
            .iter()
            .position(|state| *state == node.state);
        found.push(Row {
            name: Arc::clone(name),
            key: match order {
                Order::Name => 0,
                Order::State => place.map_or(i64::MAX, |place| place as i64),
                Order::Since => node.since_ms,
                Order::Heard => node.heard_ms.unwrap_or(i64::MIN),
                Order::Joules => node.used_uj(day),
                Order::Waiting => i64::try_from(node.waiting).unwrap_or(i64::MAX),
            },
        });
    });
    // They come by name, and the sort keeps that among equals.
    match (order, selection.down) {
        (Order::Name, true) => found.reverse(),
        (_, true) => found.sort_by_key(|row| Reverse(row.key)),
        (_, false) => found.sort_by_key(|row| row.key),
    }
    let [online, degraded, silent, offline] = view.fleet.by_state();
    let limit = selection.limit.unwrap_or(100).min(MOST);
    let nodes = found.iter().skip(selection.offset).take(limit);
    Ok(Json(NodeList {
        counts: Counts {
            online,
            degraded,
            silent,
            offline,
        },
        waiting,
        total: found.len(),
        offset: selection.offset,
        nodes: nodes.filter_map(|row| view.fleet.view(&row.name)).collect(),
    }))
}
