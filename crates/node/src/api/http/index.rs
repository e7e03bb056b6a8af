//! The list of routes.

use super::RouteState;
use albireo_service::http::{Route, routes};
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

/// Service, version and list of routes.
#[derive(Serialize, ToSchema)]
pub(super) struct Index {
    /// The node's name.
    node: String,
    /// The program's version.
    version: &'static str,
    /// The policy that decides the frames.
    policy: &'static str,
    /// Names of the cameras.
    cameras: Vec<String>,
    /// The path of the full description.
    openapi: &'static str,
    /// All routes.
    routes: Vec<Route>,
}

/// Service, version and list of routes
///
/// `curl http://127.0.0.1:8080/api/v1`
#[utoipa::path(get, path = "/api/v1", tag = "health", responses((status = 200, body = Index)))]
pub(super) async fn index(State(shared): State<RouteState>) -> Json<Index> {
    let board = &shared.board;
    Json(Index {
        node: board.node.clone(),
        version: env!("CARGO_PKG_VERSION"),
        policy: board.policy,
        cameras: shared.camera_names(),
        openapi: "/openapi.json",
        routes: routes(&super::openapi()),
    })
}
