//! Reports the caller and its permissions: a page requests it first, so that it can ask for a token and show what the
//! token allows, without provoking a refusal.

use super::Caller;
use crate::config::{ANONYMOUS, Role};
use axum::{Extension, Json};
use serde::Serialize;
use utoipa::ToSchema;

/// The caller.
#[derive(Debug, Serialize, ToSchema)]
pub struct WhoAsks {
    /// The name of the token; `anonymous` without one.
    name: String,
    /// True if the interface needs a token that the request lacks.
    token_needed: bool,
    /// True if the caller may change settings, and not only read.
    may_tune: bool,
}

/// The caller and its permissions
///
/// Open to all: it says what a token allows, or that one is needed.
/// `curl -H "Authorization: Bearer $TOKEN" http://127.0.0.1:8080/api/v1/caller`
#[utoipa::path(get, operation_id = "caller", path = "/api/v1/caller", tag = "health", security(()), responses((status = 200, body = WhoAsks)))]
pub async fn caller(Extension(caller): Extension<Caller>) -> Json<WhoAsks> {
    let tunes = caller.role == Role::Tune;
    Json(WhoAsks {
        // If no token is needed, everybody may do everything.
        token_needed: !tunes && &*caller.name == ANONYMOUS,
        may_tune: tunes,
        name: caller.name.to_string(),
    })
}
