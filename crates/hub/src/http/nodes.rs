//! Shows one node, and forgets one.

use super::HubView;
use crate::presence::NodeView;
use crate::store::ReportCounts;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::{Caller, Problem};
use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A node with what is known of its reports.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct NodeDetail {
    /// The node.
    #[serde(flatten)]
    pub node: NodeView,
    /// What is known of its reports; absent where none came.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reports: Option<ReportCounts>,
}

/// One node with what is known of its reports
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
    let reports = view.store()?.report_counts(&node).await?;
    let known = view.fleet.view(&node).ok_or_else(|| unknown(&node))?;
    Ok(Json(NodeDetail {
        node: known,
        reports,
    }))
}

pub(super) fn unknown(node: &str) -> Problem {
    let detail = format!("no node `{node}` was ever heard; /api/v1/nodes lists those that were");
    Problem::new(StatusCode::NOT_FOUND, detail)
}

/// Forget a node
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
    let still_online = || {
        let detail = format!("`{node}` is heard and would be back at once: stop it first");
        Problem::new(StatusCode::CONFLICT, detail)
    };
    if known.state.is_heard() {
        return Err(still_online());
    }
    (view.tuner()?)
        .forget(&node, &caller.name, unix_milliseconds())
        .await?;
    if !view.fleet.forget(&node) {
        return Err(still_online());
    }
    Ok(StatusCode::NO_CONTENT)
}
