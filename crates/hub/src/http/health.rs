//! Serves what the hub is: its version and its routes, whether it answers, and whether it is ready.

use crate::hub::Hub;
use albireo_service::http::{self, Problem, Route};
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Service, version and list of routes.
#[derive(Serialize, ToSchema)]
pub(super) struct Index {
    /// Always `hub`.
    service: &'static str,
    /// The program's version.
    version: &'static str,
    /// The path of the full description.
    openapi: &'static str,
    /// All routes.
    routes: Vec<Route>,
}

/// Service, version and list of routes
///
/// `curl http://127.0.0.1:8090/api/v1`
#[utoipa::path(get, path = "/api/v1", tag = "health", responses((status = 200, body = Index)))]
pub(super) async fn index() -> Json<Index> {
    Json(Index {
        service: "hub",
        version: env!("CARGO_PKG_VERSION"),
        openapi: "/openapi.json",
        routes: http::routes(&super::openapi()),
    })
}

/// The process answers.
#[derive(Serialize, ToSchema)]
pub(super) struct Health {
    /// Always `ok`.
    status: &'static str,
    /// The program's version.
    version: &'static str,
}

/// The readiness of the hub to accept and commit reports.
#[derive(Serialize, ToSchema)]
pub(super) struct HubReadiness {
    /// True if every part works.
    ready: bool,
    /// The reason of each part that does not work, or works only in part: `database`, `zenoh`,
    /// `certificates`, `fleet`, `tuning`, `tasks`.
    reasons: BTreeMap<String, String>,
}

/// [`HubReadiness`] as a problem document.
#[derive(Serialize, ToSchema)]
pub(super) struct HubNotReady {
    #[serde(flatten)]
    problem: Problem,
    #[serde(flatten)]
    readiness: HubReadiness,
}

/// Whether the process answers
///
/// `curl http://127.0.0.1:8090/healthz`
#[utoipa::path(get, operation_id = "healthz", path = "/healthz", tag = "health", security(()), responses((status = 200, body = Health)))]
pub(super) async fn healthz() -> Json<Health> {
    Json(Health {
        status: "ok",
        version: env!("CARGO_PKG_VERSION"),
    })
}

/// Whether the hub accepts reports: the database can be written, and the Zenoh session is open
///
/// `curl http://127.0.0.1:8090/readyz`
#[utoipa::path(
    get, operation_id = "readyz", path = "/readyz", tag = "health", security(()),
    responses(
        (status = 200, body = HubReadiness),
        (status = 503, body = HubNotReady, content_type = "application/problem+json"),
    )
)]
pub(super) async fn readyz(State(hub): State<Hub>) -> Response {
    let health = hub.readiness.health();
    let text = health.status().text();
    let readiness = HubReadiness {
        ready: health.is_ready(),
        reasons: health.status().reasons,
    };
    if readiness.ready {
        return Json(readiness).into_response();
    }
    let status = StatusCode::SERVICE_UNAVAILABLE;
    let problem = Problem::new(status, text);
    http::response(status, &HubNotReady { problem, readiness })
}
