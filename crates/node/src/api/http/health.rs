//! Reports liveness and readiness.

use super::RouteState;
use crate::state::board::{Board, provider};
use albireo_service::http::{self, Problem};
use albireo_service::readiness::PartFault;
use albireo_wire::HealthState;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::time::Duration;
use utoipa::ToSchema;

/// The process answers.
#[derive(Serialize, ToSchema)]
#[schema(as = Health)]
pub(crate) struct Liveness {
    /// Always `ok`.
    status: &'static str,
    /// The node.
    node: String,
    /// The program's version.
    version: &'static str,
    /// Seconds since it started.
    uptime_s: f64,
}

/// The readiness of the node, and what processes its frames.
#[derive(Serialize, ToSchema)]
pub(super) struct Readiness {
    /// True if frames are answered, perhaps with a part missing.
    ready: bool,
    /// True if every part works.
    state: HealthState,
    /// The node.
    node: String,
    /// The policy that decides frames.
    policy: &'static str,
    /// File name of the detector's model.
    model: String,
    /// Execution provider that runs the detector; absent while it starts.
    #[serde(skip_serializing_if = "Option::is_none")]
    provider: Option<&'static str>,
    /// Configured execution providers, in order.
    requested_providers: Vec<&'static str>,
    /// The faults; empty when every part works.
    reasons: Vec<PartFault>,
}

/// [`Readiness`] as a problem document.
#[derive(Serialize, ToSchema)]
pub(super) struct NotReady {
    #[serde(flatten)]
    problem: Problem,
    #[serde(flatten)]
    readiness: Readiness,
}

/// The present readiness of the node.
pub(super) fn readiness(board: &Board) -> Readiness {
    let health = board.readiness.health();
    Readiness {
        ready: health.is_ready(),
        state: health.state(),
        node: board.node.clone(),
        policy: board.policy().name,
        model: board.model.clone(),
        provider: provider(&board.detector_status()),
        requested_providers: board.providers.iter().map(|name| name.as_str()).collect(),
        reasons: health.faults,
    }
}

/// Liveness: the process answers
///
/// Touches neither the detector nor the GPU. `curl http://127.0.0.1:8080/healthz`
#[utoipa::path(get, operation_id = "healthz", path = "/healthz", tag = "health", security(()), responses((status = 200, body = Liveness)))]
pub(super) async fn healthz(State(shared): State<RouteState>) -> Json<Liveness> {
    alive(&shared.board.node, shared.board.uptime())
}

/// The answer that the process of `node` is alive.
pub(crate) fn alive(node: &str, uptime: Duration) -> Json<Liveness> {
    Json(Liveness {
        status: "ok",
        node: node.to_owned(),
        version: env!("CARGO_PKG_VERSION"),
        uptime_s: albireo_service::clock::seconds(uptime),
    })
}

/// Readiness: frames are answered, and by which execution provider
///
/// 503 while starting and when an essential part fails; 200 with reasons when another part fails.
/// `curl http://127.0.0.1:8080/readyz`
#[utoipa::path(
    get, operation_id = "readyz", path = "/readyz", tag = "health", security(()),
    responses(
        (status = 200, body = Readiness),
        (status = 503, body = NotReady, content_type = "application/problem+json"),
    )
)]
pub(super) async fn readyz(State(shared): State<RouteState>) -> Response {
    let readiness = readiness(&shared.board);
    if readiness.ready {
        return Json(readiness).into_response();
    }
    let status = StatusCode::SERVICE_UNAVAILABLE;
    let reasons = shared.board.readiness.health().status().text();
    let problem = Problem::new(status, reasons);
    http::response(status, &NotReady { problem, readiness })
}
