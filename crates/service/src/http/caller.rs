//! Reports the caller and its permissions: a page requests it first, so that it can ask for a token and show what the
//! token allows, without provoking a refusal.

use super::Caller;
use crate::config::Role;
use axum::{Extension, Json};
use serde::Serialize;
use utoipa::openapi::OpenApi;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::{Modify, ToSchema};

/// Who asks.
#[derive(Debug, Serialize, ToSchema)]
pub struct WhoAsks {
    /// Name of the token; `anonymous` without one.
    name: String,
    /// Whether what is asked of this interface needs a token that did not come with the request.
    token_needed: bool,
    /// Whether the caller may change something, and not only look.
    may_tune: bool,
}

/// Who asks, and what that one may do
///
/// Open to all: it answers what a token is good for, and that one is needed where it is missing or not known.
/// `curl -H "Authorization: Bearer $TOKEN" http://127.0.0.1:8080/api/v1/caller`
#[utoipa::path(get, operation_id = "caller", path = "/api/v1/caller", tag = "health", security(()), responses((status = 200, body = WhoAsks)))]
pub async fn caller(Extension(caller): Extension<Caller>) -> Json<WhoAsks> {
    let tunes = caller.role == Role::Tune;
    Json(WhoAsks {
        // If no token is needed, everybody may do everything.
        token_needed: !tunes && &*caller.name == Caller::ANONYMOUS,
        may_tune: tunes,
        name: caller.name.to_string(),
    })
}

/// Describes the bearer token in an OpenAPI document.
#[derive(Debug)]
pub struct TokenSecurity;

impl Modify for TokenSecurity {
    fn modify(&self, openapi: &mut OpenApi) {
        let token = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).build();
        openapi
            .components
            .get_or_insert_default()
            .add_security_scheme("token", SecurityScheme::Http(token));
    }
}
