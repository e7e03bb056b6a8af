//! The routes of a hub.

mod health;

use crate::readiness::Readiness;
use albireo_service::http::Problem;
use axum::Router;
use axum::routing::get;
use std::sync::Arc;
use utoipa::openapi::OpenApi;
use utoipa::{Modify, OpenApi as _};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// What the routes look at.
#[derive(Clone, Debug)]
pub struct HubView {
    /// Which parts do not work.
    pub readiness: Arc<Readiness>,
}

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "albireo hub",
        description = "See, count and tune a fleet of nodes. Errors are problem documents (RFC 9457). Where tokens are \
                       set, everything but `/`, `/healthz` and `/readyz` needs one; what changes something needs one \
                       with the role `tune`.",
    ),
    components(schemas(Problem)),
    modifiers(&Security),
    security((), ("token" = []))
)]
struct Description;

struct Security;

impl Modify for Security {
    fn modify(&self, openapi: &mut OpenApi) {
        use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
        let token = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).build();
        openapi
            .components
            .get_or_insert_default()
            .add_security_scheme("token", SecurityScheme::Http(token));
    }
}

fn described() -> OpenApiRouter<HubView> {
    OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
}

/// The OpenAPI document of a hub, as `/openapi.json` gives it.
pub fn openapi() -> OpenApi {
    described().split_for_parts().1
}

/// All routes, with their description.
pub fn router(view: HubView) -> Router {
    let (router, openapi) = described().split_for_parts();
    let openapi = Arc::new(openapi);
    router
        .route(
            "/openapi.json",
            get(move || async move { axum::Json(Arc::unwrap_or_clone(openapi)) }),
        )
        .with_state(view)
}
