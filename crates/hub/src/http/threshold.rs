//! Sets a threshold on selected nodes.

use super::HubView;
use super::body;
use super::order::{OrderAnswer, carry_out};
use crate::tuning::change::ChangeRequest;
use crate::tuning::selector::Selector;
use albireo_service::http::{Caller, Problem};
use albireo_wire::DesiredSetting;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{Extension, State};
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

/// A value for selected nodes. The value is beside these fields under the policy's name for it: `"u": 5e-4`.
#[derive(Debug, Deserialize, ToSchema)]
pub(super) struct ThresholdRequest {
    /// Which nodes: names, globs, labels, `all`.
    #[schema(value_type = Vec<String>, examples(json!(["cam-*", "region=north"])))]
    select: Selector,
    /// Only say who would change.
    #[serde(default)]
    dry_run: bool,
    /// Why; kept in the history.
    #[serde(default)]
    why: String,
    /// How long to wait for the nodes, seconds: 5 by default, at most 8 for a plain answer.
    #[serde(default)]
    wait_s: Option<f64>,
}

/// Sets a value on selected nodes
///
/// It holds at a node when the node **reports** it. `Accept: application/x-ndjson` streams each node's outcome as it comes; otherwise
/// the answer waits a few seconds for the nodes. Nodes out of reach find the value on their return. A node that holds a target
/// holds it no more.
/// `curl -X PUT -d '{"u": 5e-4, "select": ["cam-*"]}' http://127.0.0.1:8090/api/v1/threshold`
#[utoipa::path(
    put, operation_id = "set_threshold", path = "/api/v1/threshold", tag = "tuning", request_body = ThresholdRequest,
    responses(
        (status = 200, body = OrderAnswer),
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
    let object = body::object(bytes)?;
    let (threshold, request): (_, ThresholdRequest) = body::with_threshold(object)?;
    let change = ChangeRequest {
        setting: DesiredSetting::Threshold(threshold),
        select: request.select,
        dry_run: request.dry_run,
        why: request.why,
    };
    carry_out(&view, &caller, &headers, change, request.wait_s).await
}
