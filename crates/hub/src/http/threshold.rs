//! A value for selected nodes, and the history of what was ordered.

use super::HubView;
use super::body;
use crate::store::{OrderNodeRow, OrderRow, StoreError, knob};
use crate::tuning::change::{Change, ChangeRequest};
use crate::tuning::selector::Selector;
use crate::tuning::tuner::{Drift, OutcomeLine};
use albireo_service::http::{Caller, Problem};
use albireo_wire::KnobValue;
use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::rejection::BytesRejection;
use axum::extract::{Extension, Path, Query, State};
use axum::http::header::{ACCEPT, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;
use utoipa::{IntoParams, ToSchema};

/// The media type of outcomes as they come, one JSON object a line.
const LINES: &str = "application/x-ndjson";
/// How long a plain answer waits for the nodes at most: an answer that begins too late is an error.
const LONGEST_WAIT_S: f64 = 8.0;
/// What of the time of a request is left for the order and the answer.
const ANSWER_S: f64 = 1.0;
/// How long a stream of outcomes lasts at most.
const LONGEST_STREAM_S: f64 = 3_600.0;
/// Most orders of one answer.
const MOST_ORDERS: i64 = 500;

/// A value for selected nodes. Beside these fields stands the value under its knob's name: `"u": 5e-4`.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ThresholdRequest {
    /// Which nodes: names, globs, labels, `all`.
    #[schema(value_type = Vec<String>, examples(json!(["cam-*", "region=north"])))]
    select: Selector,
    /// Only say who would change.
    #[serde(default)]
    dry_run: bool,
    /// Why; stands in the history.
    #[serde(default)]
    why: String,
    /// How long to wait for the nodes, seconds: 5 by default, at most 8 for a plain answer.
    #[serde(default)]
    wait_s: Option<f64>,
}

/// What an order came to.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ThresholdAnswer {
    /// Number of the order: `/api/v1/changes/{change}` tells how it went on. Absent in a dry run, and when nobody was to change.
    #[serde(skip_serializing_if = "Option::is_none")]
    change: Option<u64>,
    /// Whether nothing was done.
    dry_run: bool,
    /// How many nodes have which outcome.
    counts: BTreeMap<String, usize>,
    /// Each node.
    nodes: Vec<OutcomeLine>,
}

/// The last line of a stream.
#[derive(Debug, Serialize, ToSchema)]
struct LastLine {
    change: Option<u64>,
    counts: BTreeMap<String, usize>,
}

pub(super) fn of_store(error: &StoreError) -> Problem {
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, error.to_string())
}

/// Sets a value on selected nodes
///
/// It holds at a node when the node **reports** it. `Accept: application/x-ndjson` streams each node's outcome as it comes; otherwise
/// the answer waits a few seconds for the nodes. Nodes out of reach find the value on their return.
/// `curl -X PUT -d '{"u": 5e-4, "select": ["cam-*"]}' http://127.0.0.1:8090/api/v1/threshold`
#[utoipa::path(
    put, operation_id = "set_threshold", path = "/api/v1/threshold", tag = "tuning", request_body = ThresholdRequest,
    responses(
        (status = 200, body = ThresholdAnswer),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn put(
    State(view): State<HubView>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    bytes: Result<Bytes, BytesRejection>,
) -> Result<Response, Problem> {
    let mut object = body::object(bytes)?;
    let knob = body::knob(&mut object)?;
    let request: ThresholdRequest = body::rest(object)?;
    if request.why.len() > 500 {
        return Err(body::unusable("why: must have at most 500 bytes"));
    }
    let streams = headers
        .get(ACCEPT)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|accept| accept.contains(LINES));
    let most = if streams {
        LONGEST_STREAM_S
    } else {
        (view.timeout.as_secs_f64() - ANSWER_S).clamp(0.0, LONGEST_WAIT_S)
    };
    let wait = request.wait_s.unwrap_or(most.min(5.0));
    if !(0.0..=most).contains(&wait) {
        return Err(body::unusable(format!(
            "wait_s: must be from 0 to {most}, not {wait}"
        )));
    }
    let dry_run = request.dry_run;
    let change = view
        .tuner()?
        .change(
            ChangeRequest {
                knob,
                select: request.select,
                dry_run,
                why: request.why,
            },
            &caller.name,
        )
        .await
        .map_err(|error| of_store(&error))?;
    if change.lines.is_empty() && change.awaited.is_empty() {
        return Err(Problem::new(
            StatusCode::NOT_FOUND,
            "no node is selected; GET /api/v1/nodes lists all",
        ));
    }
    let until = Instant::now() + Duration::from_secs_f64(wait);
    let mut following = Following {
        change,
        until,
        last: BTreeMap::new(),
    };
    if streams {
        let stream = futures_util::stream::unfold(Some(following), |following| async move {
            let mut following = following?;
            let (line, next) = match following.next().await {
                Some(line) => (serde_json::to_string(&line), Some(following)),
                None => {
                    let last = LastLine {
                        change: following.change.generation,
                        counts: following.counts(),
                    };
                    (serde_json::to_string(&last), None)
                }
            };
            let line = line.map(|line| line + "\n").map_err(std::io::Error::other);
            Some((line, next))
        });
        return Ok(([(CONTENT_TYPE, LINES)], Body::from_stream(stream)).into_response());
    }
    while following.next().await.is_some() {}
    let answer = ThresholdAnswer {
        change: following.change.generation,
        dry_run,
        counts: following.counts(),
        nodes: following.last.into_values().collect(),
    };
    Ok(Json(answer).into_response())
}

/// Brings the outcomes until every node has one, or the time is over.
struct Following {
    change: Change,
    until: Instant,
    last: BTreeMap<String, OutcomeLine>,
}

impl Following {
    async fn next(&mut self) -> Option<OutcomeLine> {
        let line = match self.change.lines.pop() {
            Some(line) => line,
            None if self.change.awaited.is_empty() => return None,
            None => match tokio::time::timeout_at(self.until, self.change.follow.recv()).await {
                Ok(line) => line?,
                Err(_) => self.not_answered()?,
            },
        };
        if line.is_final() {
            self.change.awaited.remove(&line.node);
        }
        self.last.insert(line.node.clone(), line.clone());
        Some(line)
    }

    /// The time is over: what is still awaited is said to be so, unless that was said before.
    fn not_answered(&mut self) -> Option<OutcomeLine> {
        while let Some(node) = self.change.awaited.iter().next().cloned() {
            self.change.awaited.remove(&node);
            if !self.last.contains_key(&node) {
                return Some(OutcomeLine {
                    node,
                    outcome: "pending",
                    from: None,
                    to: self.change.knob,
                    detail: "not answered yet".to_owned(),
                });
            }
        }
        None
    }

    fn counts(&self) -> BTreeMap<String, usize> {
        let mut counts = BTreeMap::new();
        for line in self.last.values() {
            *counts.entry(line.outcome.to_owned()).or_insert(0) += 1;
        }
        counts
    }
}

/// One order of the history.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ChangeView {
    /// Its number: the generation of the value.
    change: i64,
    /// When, milliseconds since the Unix epoch.
    at_ms: i64,
    /// Who: the name of the token.
    who: String,
    /// Why.
    why: String,
    /// `hand`, `rollout 3`, `trial 4`, `drift`.
    origin: String,
    /// Who was selected; empty where a rollout or trial chose.
    select: String,
    /// The value.
    #[schema(value_type = BTreeMap<String, f64>)]
    to: KnobValue,
    /// How many nodes have which outcome.
    counts: BTreeMap<String, i64>,
}

/// What became of an order at a node.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ChangeNode {
    node: String,
    outcome: String,
    /// When that was known, milliseconds since the Unix epoch.
    at_ms: i64,
    /// The value before.
    #[schema(value_type = Option<BTreeMap<String, f64>>)]
    from: Option<KnobValue>,
    #[serde(skip_serializing_if = "String::is_empty")]
    detail: String,
}

/// One order with its nodes.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ChangeDetail {
    #[serde(flatten)]
    change: ChangeView,
    nodes: Vec<ChangeNode>,
}

/// Orders, the newest first.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Changes {
    changes: Vec<ChangeView>,
    /// Give it as `before` for the next page; absent on the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<i64>,
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
/// Who ordered which value for whom, why, and what became of it.
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
    let orders = store
        .orders(
            which.before.unwrap_or(i64::MAX),
            which.node.as_deref(),
            limit,
        )
        .await;
    let orders = orders.map_err(|error| of_store(&error))?;
    let next = orders
        .last()
        .filter(|_| orders.len() as i64 == limit)
        .map(|order| order.generation);
    let span = orders
        .last()
        .zip(orders.first())
        .map(|(last, first)| (last.generation, first.generation));
    let counted = match span {
        Some((from, to)) => store
            .outcome_counts(from, to)
            .await
            .map_err(|error| of_store(&error))?,
        None => Vec::new(),
    };
    let changes: Result<Vec<_>, _> = orders
        .into_iter()
        .map(|order| change_view(order, &counted))
        .collect();
    Ok(Json(Changes {
        changes: changes.map_err(|error| of_store(&error))?,
        next,
    }))
}

fn change_view(order: OrderRow, counted: &[(i64, String, i64)]) -> Result<ChangeView, StoreError> {
    let counts = counted
        .iter()
        .filter(|(generation, ..)| *generation == order.generation);
    Ok(ChangeView {
        change: order.generation,
        at_ms: order.at_ms,
        to: knob(order.knob, &order.value)?,
        who: order.who,
        why: order.why,
        origin: order.origin,
        select: order.selector,
        counts: counts
            .map(|(_, outcome, nodes)| (outcome.clone(), *nodes))
            .collect(),
    })
}

/// One change with every node
#[utoipa::path(
    get, operation_id = "change", path = "/api/v1/changes/{change}", tag = "tuning",
    params(("change" = i64, Path, description = "Its number.")),
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
    let failed = |error: StoreError| of_store(&error);
    let orders = store
        .orders(number.saturating_add(1), None, 1)
        .await
        .map_err(failed)?;
    let order = orders.into_iter().find(|order| order.generation == number);
    let order = order.ok_or_else(|| {
        Problem::new(
            StatusCode::NOT_FOUND,
            format!("there is no change {number}"),
        )
    })?;
    let counted = store.outcome_counts(number, number).await.map_err(failed)?;
    let nodes = store
        .order_nodes(number, number, None)
        .await
        .map_err(failed)?;
    let name = order.knob.clone();
    let node = |row: OrderNodeRow| -> Result<ChangeNode, StoreError> {
        Ok(ChangeNode {
            from: row
                .from_value
                .map(|value| knob(name.clone(), &value))
                .transpose()?,
            node: row.node,
            outcome: row.outcome,
            at_ms: row.at_ms,
            detail: row.detail,
        })
    };
    let nodes: Result<Vec<_>, _> = nodes.into_iter().map(node).collect();
    Ok(Json(ChangeDetail {
        change: change_view(order, &counted).map_err(failed)?,
        nodes: nodes.map_err(failed)?,
    }))
}

/// Nodes whose value is not the desired one
///
/// They had taken it, and it was changed at the node since.
#[utoipa::path(get, operation_id = "list_drift", path = "/api/v1/drift", tag = "tuning", responses((status = 200, body = Vec<Drift>)))]
pub(super) async fn drift(State(view): State<HubView>) -> Result<Json<Vec<Drift>>, Problem> {
    Ok(Json(view.tuner()?.drift()))
}
