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
    document
        .paths
        .paths
        .iter()
        .flat_map(|(path, item)| {
            let methods = [
                ("GET", &item.get),
                ("PUT", &item.put),
                ("POST", &item.post),
                ("DELETE", &item.delete),
            ];
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
