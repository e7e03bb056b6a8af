//! Serves the index of the HTTP interface.

use albireo_service::http::{Route, routes};
use axum::Json;
use serde::Serialize;
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
        routes: routes(&super::openapi()),
    })
}
