//! The history of orders, and nodes that have something else.

use super::HubView;
use crate::store::{OrderNodeRow, OrderRow};
use crate::tuning::tuner::Drift;
use albireo_service::http::Problem;
use albireo_wire::DesiredSetting;
use axum::Json;
use axum::extract::{Path, Query, State};
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::{IntoParams, ToSchema};

/// Most orders of one answer.
const MOST_ORDERS: i64 = 500;

/// One order of the history.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ChangeView {
    /// Its number, which nodes report as the revision of their setting.
    pub revision: i64,
    /// When, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// Who: the name of the token.
    pub who: String,
    /// Why.
    pub why: String,
    /// `hand`, `rollout 3`, `trial 4`, `drift`.
    pub origin: String,
    /// Who was selected; empty where a rollout or trial chose.
    pub select: String,
    /// What was ordered: a threshold, or a target (null switches it off).
    pub to: DesiredSetting,
    /// How many nodes have which outcome.
    pub counts: BTreeMap<String, i64>,
}

/// What became of an order at a node.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ChangeNode {
    /// The node.
    pub node: String,
    /// `applied`, `refused`, `waiting`, `timed_out`, `pending`, `superseded` or `missed`.
    pub outcome: String,
    /// When that was known, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// Its setting before: a threshold or a target.
    pub from: Option<DesiredSetting>,
    /// Why, where there is something to say.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub detail: String,
}

/// One order with its nodes.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ChangeDetail {
    /// The order.
    #[serde(flatten)]
    pub change: ChangeView,
    /// What became of it at each.
    pub nodes: Vec<ChangeNode>,
}

/// Orders, the newest first.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Changes {
    /// One entry for each order.
    pub changes: Vec<ChangeView>,
    /// Give it as `before` for the next page; absent on the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<i64>,
}

/// Which orders.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct WhichChanges {
    /// Only those of this node.
    node: Option<String>,
    /// Only those before this number.
    before: Option<i64>,
    /// How many at most; 50 by default.
    limit: Option<i64>,
}

/// The history of changes
///
/// A change: author, nodes, setting, reason and outcome.
#[utoipa::path(
    get, operation_id = "list_changes", path = "/api/v1/changes", tag = "tuning", params(WhichChanges),
    responses(
        (status = 200, body = Changes),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn changes(
    State(view): State<HubView>,
    Query(which): Query<WhichChanges>,
) -> Result<Json<Changes>, Problem> {
    let store = view.tuner()?.store();
    let limit = which.limit.unwrap_or(50).clamp(1, MOST_ORDERS);
    let before = which.before.unwrap_or(i64::MAX);
    let orders = store.orders(before, which.node.as_deref(), limit).await?;
    let next = orders
        .last()
        .filter(|_| orders.len() as i64 == limit)
        .map(|order| order.revision);
    let span = orders
        .last()
        .zip(orders.first())
        .map(|(last, first)| (last.revision, first.revision));
    let counted = match span {
        Some((from, to)) => store.outcome_counts(from, to).await?,
        None => Vec::new(),
    };
    let changes = orders.into_iter().map(|order| change_view(order, &counted));
    Ok(Json(Changes {
        changes: changes.collect(),
        next,
    }))
}

fn change_view(order: OrderRow, counted: &[(i64, String, i64)]) -> ChangeView {
    let counts = counted
        .iter()
        .filter(|(revision, ..)| *revision == order.revision);
    ChangeView {
        revision: order.revision,
        at_ms: order.at_ms,
        to: order.setting,
        who: order.who,
        why: order.why,
        origin: order.origin,
        select: order.selector,
        counts: counts
            .map(|(_, outcome, nodes)| (outcome.clone(), *nodes))
            .collect(),
    }
}

/// One change with every node
#[utoipa::path(
    get, operation_id = "change", path = "/api/v1/changes/{revision}", tag = "tuning",
    params(("revision" = i64, Path, description = "Its number.")),
    responses(
        (status = 200, body = ChangeDetail),
        (status = 404, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn change(
    State(view): State<HubView>,
    Path(number): Path<i64>,
) -> Result<Json<ChangeDetail>, Problem> {
    let store = view.tuner()?.store();
    let orders = store.orders(number.saturating_add(1), None, 1).await?;
    let order = orders.into_iter().find(|order| order.revision == number);
    let order = order.ok_or_else(|| {
        Problem::new(
            StatusCode::NOT_FOUND,
            format!("there is no change {number}"),
        )
    })?;
    let counted = store.outcome_counts(number, number).await?;
    let nodes = store.order_nodes(number, number, None).await?;
    let node = |row: OrderNodeRow| ChangeNode {
        from: row.setting_before,
        node: row.node,
        outcome: row.outcome,
        at_ms: row.at_ms,
        detail: row.detail,
    };
    Ok(Json(ChangeDetail {
        change: change_view(order, &counted),
        nodes: nodes.into_iter().map(node).collect(),
    }))
}

/// Nodes whose setting differs from the desired one
///
/// They took it, and it was changed at the node since: another value, another target, or none any more.
#[utoipa::path(get, operation_id = "list_drift", path = "/api/v1/drift", tag = "tuning", responses((status = 200, body = Vec<Drift>)))]
pub(super) async fn drift(State(view): State<HubView>) -> Result<Json<Vec<Drift>>, Problem> {
    Ok(Json(view.tuner()?.drift()))
}
