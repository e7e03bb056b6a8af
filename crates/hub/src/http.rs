//! Defines the routes of a hub.

mod body;

mod clips;
mod diag;
mod energy;
mod events;
mod health;
mod live;
mod metrics;
mod nodes;
mod positions;
mod revisions;
mod runs;

pub use energy::Energy;
pub use nodes::{NodeDetail, NodeList};
pub use revisions::{OutcomeLine, Revision, Revisions};
pub use runs::Runs;

use crate::history::{EnergyBy, Sort, StoredEvent};
use crate::hub::Hub;
use crate::tuning::run::Command;
use albireo_service::http::{self, Problem};
use albireo_wire::CountersMessage;
use axum::routing::get;
use axum::{Json, Router};
use utoipa::OpenApi as _;
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "albireo hub",
        description = "Monitors and tunes a fleet of nodes. Errors are problem documents (RFC 9457). If tokens are \
                       configured, every route needs one, except `/` and what it loads, `/api/v1/caller`, `/healthz` and \
                       `/readyz`. Routes that change something need one with the role `tune`.",
    ),
    // OpenAPI cannot describe the contents of an event stream, but it can describe the messages in it.
    components(schemas(
        Problem,
        StoredEvent,
        CountersMessage,
        // Parameters do not register their own schemas.
        EnergyBy,
        Sort,
        Command
    )),
    security((), ("token" = []))
)]
struct Description;

#[expect(
    clippy::cognitive_complexity,
    reason = "one line for each route, whose macro counts as a branch"
)]
fn described() -> (Router<Hub>, OpenApi) {
    let routes = OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(http::caller))
        .routes(routes!(health::index))
        .routes(routes!(metrics::text))
        .routes(routes!(nodes::list))
        .routes(routes!(nodes::one, nodes::forget))
        .routes(routes!(live::live))
        .routes(routes!(live::picture))
        .routes(routes!(clips::list))
        .routes(routes!(clips::csv))
        .routes(routes!(clips::set_aside))
        .routes(routes!(energy::sums))
        .routes(routes!(positions::geojson))
        .routes(routes!(positions::delete))
        .routes(routes!(events::stream))
        .routes(routes!(diag::archive))
        .routes(routes!(revisions::set_threshold))
        .routes(routes!(revisions::set_target))
        .routes(routes!(revisions::revisions))
        .routes(routes!(revisions::revision))
        .routes(routes!(revisions::drift))
        .routes(routes!(runs::rollouts, runs::begin_rollout))
        .routes(routes!(runs::one_rollout))
        .routes(routes!(runs::command_rollout))
        .routes(routes!(runs::trials, runs::begin_trial))
        .routes(routes!(runs::one_trial))
        .routes(routes!(runs::end_trial));
    let (router, mut openapi) = routes.split_for_parts();
    http::describe(&mut openapi);
    (router, openapi)
}

/// The OpenAPI document of a hub, as `/openapi.json` gives it.
pub fn openapi() -> OpenApi {
    described().1
}

/// Returns all routes, with their description.
pub(crate) fn router(hub: Hub) -> Router {
    let (router, document) = described();
    let router = http::refuse_unread_queries(router, document);
    http::with_page(router, "hub.html")
        .route("/openapi.json", get(|| async { Json(openapi()) }))
        .with_state(hub)
}
