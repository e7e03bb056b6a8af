//! The list of routes that a service returns at `/api/v1`.

use serde::Serialize;
use utoipa::ToSchema;
use utoipa::openapi::OpenApi;

/// A route.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Route {
    /// `GET`, `PUT`, `POST` or `DELETE`.
    method: &'static str,
    /// Its path; `{camera}` is replaced by a camera's name.
    path: String,
    /// Its summary.
    summary: String,
}

/// The routes in `document`, by path.
pub fn routes(document: &OpenApi) -> Vec<Route> {
    let mut routes = Vec::new();
    for (path, item) in &document.paths.paths {
        for (method, operation) in [
            ("GET", &item.get),
            ("PUT", &item.put),
            ("POST", &item.post),
            ("DELETE", &item.delete),
        ] {
            if let Some(operation) = operation {
                routes.push(Route {
                    method,
                    path: path.clone(),
                    summary: operation.summary.clone().unwrap_or_default(),
                });
            }
        }
    }
    routes
}
