//! Serves desired settings: gives them to selected nodes, and shows their revisions and the nodes that drifted.

pub use crate::tuning::revision::Revision;

use super::body;
use crate::hub::Hub;
use crate::tuning::desired::NodeSetting;
use crate::tuning::plan::check_why;
use crate::tuning::revision::NewRevision;
use crate::tuning::tuner::Drift;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::{Caller, Problem, within};
use albireo_wire::{DesiredSetting, Target};
use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::{Extension, Path, Query, State};
use axum::http::header::{ACCEPT, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use utoipa::{IntoParams, ToSchema};

/// Most revisions per answer.
const MOST: i64 = 500;
/// The media type of a stream of outcomes, one JSON object per line.
const LINES: &str = "application/x-ndjson";
/// Longest wait of a plain answer for the nodes, seconds: below the 10 s that a request may take.
const LONGEST_WAIT_S: f64 = 8.0;
/// Longest stream of outcomes, seconds.
const LONGEST_STREAM_S: f64 = 3_600.0;

/// A line of a stream.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub enum OutcomeLine {
    /// The outcome at one node.
    Outcome(NodeSetting),
    /// The end of the stream.
    Last(Revision),
}

/// Sets a value on selected nodes
///
/// A node has the value once it **reports** the value. With `Accept: application/x-ndjson` the outcome of each node is
/// streamed; otherwise the answer waits a few seconds for the nodes. A node that is out of reach gets the value when it
/// returns. The value switches off a node's target.
/// `curl -X PUT -d '{"u": 5e-4, "select": ["cam-*"]}' http://127.0.0.1:8090/api/v1/threshold`
#[utoipa::path(
    put, operation_id = "set_threshold", path = "/api/v1/threshold", tag = "tuning", request_body = NewRevision,
    responses((status = 200, body = Revision))
)]
pub(super) async fn set_threshold(
    State(hub): State<Hub>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    bytes: Bytes,
) -> Result<Response, Problem> {
    let (threshold, request) = body::with_threshold(body::object(&bytes)?)?;
    let setting = DesiredSetting::Threshold(threshold);
    give(&hub, &caller, &headers, setting, request).await
}

/// Sets a target on selected nodes instead of a threshold
///
/// A node has the target once it **reports** the target; its status says whether the target is met. A threshold that is
/// set later, here or at the node, switches the target off; `"target": null` does so and keeps the threshold. Otherwise
/// this works like `/api/v1/threshold`.
/// `curl -X PUT -d '{"target": {"skip_rate": 0.5}, "select": ["cam-*"]}' http://127.0.0.1:8090/api/v1/target`
#[utoipa::path(
    put, operation_id = "set_target", path = "/api/v1/target", tag = "tuning", request_body = NewRevision,
    responses((status = 200, body = Revision))
)]
pub(super) async fn set_target(
    State(hub): State<Hub>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    bytes: Bytes,
) -> Result<Response, Problem> {
    let mut object = body::object(&bytes)?;
    let refused = |detail: String| body::unusable(detail).allowing(Target::NAMES);
    let Some(value) = object.remove("target") else {
        let detail = r#"the body must have a target, such as "target": {"skip_rate": 0.5}, or null for none"#;
        return Err(refused(detail.to_owned()));
    };
    let target: Option<Target> =
        serde_json::from_value(value).map_err(|error| refused(format!("target: {error}")))?;
    let checked = match target {
        Some(target) => Some(target.check().map_err(|error| refused(error.to_string()))?),
        None => None,
    };
    let request = body::known_fields(object)?;
    let setting = DesiredSetting::Target(checked);
    give(&hub, &caller, &headers, setting, request).await
}

/// Gives a setting, and answers with the outcomes: as a stream of lines if the caller accepts one, else after `wait_s`
/// seconds at most.
async fn give(
    hub: &Hub,
    caller: &Caller,
    headers: &HeaderMap,
    setting: DesiredSetting,
    request: NewRevision,
) -> Result<Response, Problem> {
    check_why(&request.why).map_err(body::unusable)?;
    let is_stream = headers
        .get(ACCEPT)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|accept| accept.contains(LINES));
    let most = if is_stream {
        LONGEST_STREAM_S
    } else {
        LONGEST_WAIT_S
    };
    let wait = request.wait_s.unwrap_or(most.min(5.0));
    if !(0.0..=most).contains(&wait) {
        return Err(body::unusable(format!(
            "wait_s: must be from 0 to {most}, not {wait}"
        )));
    }
    let tuner = Arc::clone(hub.tuner()?);
    let now = unix_milliseconds();
    let mut revision = tuner.set(setting, request, &caller.name, now).await?;
    if revision.nodes.is_empty() {
        return Err(Problem::new(
            StatusCode::NOT_FOUND,
            "no node is selected; `albireo fleet ls` and GET /api/v1/nodes list all",
        ));
    }
    let until = Instant::now() + Duration::from_secs_f64(wait);
    if !is_stream {
        let mut nodes = Vec::new();
        while !revision.nodes.is_empty() {
            nodes.extend(tuner.outcomes(&mut revision, until).await);
        }
        nodes.sort_by(|a, b| a.node.cmp(&b.node));
        return Ok(Json(Revision { nodes, ..revision }).into_response());
    }
    // The revision has the nodes whose outcome is still to be sent; after the last line there is none.
    let texts = stream::unfold((tuner, Some(revision)), move |(tuner, rest)| async move {
        let mut rest = rest?;
        if rest.nodes.is_empty() {
            let last_line = written(&[rest]);
            return Some((last_line, (tuner, None)));
        }
        let known = tuner.outcomes(&mut rest, until).await;
        Some((written(&known), (tuner, Some(rest))))
    });
    Ok(([(CONTENT_TYPE, LINES)], Body::from_stream(texts)).into_response())
}

/// The lines as JSON.
fn written<T: Serialize>(lines: &[T]) -> Result<String, serde_json::Error> {
    lines.iter().map(|line| Ok(serde_json::to_string(line)? + "\n")).collect()
}

/// Revisions, the newest first.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Revisions {
    /// One entry for each revision.
    pub revisions: Vec<Revision>,
    /// The `before` of the next page; absent on the last page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<i64>,
}

/// Selects revisions.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct WhichRevisions {
    /// Only those that gave this node a setting.
    node: Option<String>,
    /// Only those with a lower number.
    before: Option<i64>,
    /// Maximum number, up to 500; 50 by default.
    limit: Option<i64>,
}

/// The history of desired settings
///
/// Each revision has its author, nodes, setting, reason and outcome.
#[utoipa::path(
    get, operation_id = "list_revisions", path = "/api/v1/revisions", tag = "tuning", params(WhichRevisions),
    responses((status = 200, body = Revisions))
)]
pub(super) async fn revisions(
    State(hub): State<Hub>,
    Query(which): Query<WhichRevisions>,
) -> Result<Json<Revisions>, Problem> {
    let limit = within("limit", which.limit.unwrap_or(50), 1..=MOST)?;
    let before = which.before.unwrap_or(i64::MAX);
    let node = which.node.as_deref();
    let mut revisions = hub.store()?.revisions(before, node, limit + 1).await?;
    let next = body::cut_page(&mut revisions, limit, |found| {
        found.number.map_or(0, u64::cast_signed)
    });
    Ok(Json(Revisions { revisions, next }))
}

/// One revision with every node
#[utoipa::path(
    get, operation_id = "revision", path = "/api/v1/revisions/{revision}", tag = "tuning",
    params(("revision" = u64, Path, description = "Its number.")),
    responses((status = 200, body = Revision))
)]
pub(super) async fn revision(
    State(hub): State<Hub>,
    Path(number): Path<u64>,
) -> Result<Json<Revision>, Problem> {
    let store = hub.store()?;
    let before = number.saturating_add(1).try_into().unwrap_or(i64::MAX);
    let mut found = store
        .revisions(before, None, 1)
        .await?
        .into_iter()
        .find(|found| found.number == Some(number))
        .ok_or_else(|| {
            let detail = format!("there is no revision {number}");
            Problem::new(StatusCode::NOT_FOUND, detail)
        })?;
    found.nodes = store.revision_nodes(number).await?;
    Ok(Json(found))
}

/// Nodes whose setting differs from the desired one
///
/// These nodes applied the desired setting, and somebody changed it at the node since then.
#[utoipa::path(get, operation_id = "list_drift", path = "/api/v1/drift", tag = "tuning", responses((status = 200, body = Vec<Drift>)))]
pub(super) async fn drift(State(hub): State<Hub>) -> Result<Json<Vec<Drift>>, Problem> {
    Ok(Json(hub.tuner()?.drift()))
}
