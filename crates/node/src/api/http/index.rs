//! The interface in one answer, for whoever finds it without a manual.

use super::RouteState;
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;
use utoipa::openapi::OpenApi;

/// A route.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Route {
    /// `GET` or `PUT`.
    method: &'static str,
    /// Its path; `{camera}` stands for a camera's name.
    path: String,
    /// What it is for.
    summary: String,
}

/// Who answers here, and what can be asked.
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
    /// The interface described in full.
    openapi: &'static str,
    /// What can be asked.
    routes: Vec<Route>,
}

/// The routes that `document` describes, by path.
pub(super) fn routes(document: &OpenApi) -> Vec<Route> {
    let paths = document.paths.paths.iter();
    paths
        .flat_map(|(path, item)| {
            let methods = [("GET", &item.get), ("PUT", &item.put)];
            methods.into_iter().filter_map(move |(method, operation)| {
                Some(Route {
                    method,
                    path: path.clone(),
                    summary: operation.as_ref()?.summary.clone().unwrap_or_default(),
                })
            })
        })
        .collect()
}

/// Who answers here, and what can be asked
///
/// `curl http://127.0.0.1:8080/api/v1`
#[utoipa::path(get, path = "/api/v1", tag = "health", responses((status = 200, body = Index)))]
pub(super) async fn index(State(shared): State<RouteState>) -> Json<Index> {
    let board = shared.board();
    Json(Index {
        node: board.node().to_owned(),
        version: env!("CARGO_PKG_VERSION"),
        policy: board.policy(),
        cameras: (board.cameras().iter())
            .map(|camera| camera.name().to_owned())
            .collect(),
        openapi: "/openapi.json",
        routes: shared.routes.to_vec(),
    })
}
