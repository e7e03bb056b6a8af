//! Defines the routes of a hub.

mod body;
mod changes;
mod clips;
mod diag;
mod energy;
mod events;
mod health;
mod live;
mod metrics;
mod nodes;
mod runs;

pub use changes::{ChangeView, Changes, OrderAnswer, OrderLine};
pub use energy::Energy;
pub use nodes::{NodeDetail, NodeList};
pub use runs::Runs;

use crate::config::HubConfig;
use crate::desired::Desires;
use crate::ingest::IngestCounters;
use crate::presence::Fleet;
use crate::store::{EnergyBy, Sort, Store, StoreError, StoredEvent};
use crate::tuning::Tuner;
use crate::tuning::run::Command;
use albireo_service::http::{self, Problem};
use albireo_service::readiness::Readiness;
use albireo_wire::{CountersMessage, Desired};
use axum::http::StatusCode;
use axum::routing::get;
use axum::{Json, Router};
use std::sync::{Arc, OnceLock};
use std::time::Instant;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use utoipa::OpenApi as _;
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;
use zenoh::Session;

/// The state that all routes share.
#[derive(Clone, Debug)]
pub struct HubView {
    /// The faults of its parts: `database`, `zenoh`, `fleet`, `tuning`, `tasks`.
    pub readiness: Readiness,
    /// All nodes.
    pub fleet: Arc<Fleet>,
    /// The desired settings of the nodes.
    pub desires: Arc<Desires>,
    /// Counters of what is received and stored.
    pub ingest: Arc<IngestCounters>,
    /// Cancelled when the hub stops.
    pub shutdown: CancellationToken,
    /// The tuner, once the database is open.
    pub(crate) opened: Arc<OnceLock<Arc<Tuner>>>,
    /// The Zenoh session, once it is open.
    pub(crate) session: Arc<OnceLock<Session>>,
    /// The prefix of all keys.
    prefix: Arc<str>,
    /// Limits the number of readers that watch nodes at a time.
    live: Arc<Semaphore>,
    /// Days that five-minute sums are kept.
    five_minutes_days: u32,
    /// The configuration without its secrets.
    config: Arc<serde_json::Value>,
    started: Instant,
}

impl HubView {
    /// A hub that knows no node yet.
    pub(crate) fn new(config: &HubConfig, desires: Desires, shutdown: CancellationToken) -> Self {
        Self {
            readiness: Readiness::default(),
            fleet: Arc::new(Fleet::new(&config.presence)),
            desires: Arc::new(desires),
            ingest: Arc::default(),
            shutdown,
            opened: Arc::default(),
            session: Arc::default(),
            prefix: config.hub.prefix.as_str().into(),
            live: Arc::new(Semaphore::new(live::MOST_LIVE)),
            five_minutes_days: config.history.five_minutes_days,
            config: Arc::new(diag::without_secrets(config)),
            started: Instant::now(),
        }
    }

    /// The answer to a pull of `node`: its desired setting, and true if it should send its full status.
    pub(crate) fn desired(&self, node: &str) -> Desired {
        Desired {
            heartbeat_s: Some(self.fleet.heartbeat_s()),
            send_full_status: self.fleet.needs_full_status(node),
            ..self.desires.of(node)
        }
    }

    /// The tuner.
    ///
    /// # Errors
    /// A problem document while the database is not open yet.
    pub(crate) fn tuner(&self) -> Result<&Arc<Tuner>, Problem> {
        attached(&self.opened, "the database")
    }

    /// The database.
    ///
    /// # Errors
    /// A problem document while it is not open yet.
    pub(crate) fn store(&self) -> Result<&Store, Problem> {
        Ok(&self.tuner()?.store)
    }
}

fn attached<'a, T>(part: &'a OnceLock<T>, name: &str) -> Result<&'a T, Problem> {
    part.get().ok_or_else(|| {
        let detail = format!("{name} is not open yet; /readyz says why");
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail)
    })
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        let status = if error.passes() {
            StatusCode::SERVICE_UNAVAILABLE
        } else {
            StatusCode::INTERNAL_SERVER_ERROR
        };
        Self::new(status, error.to_string())
    }
}

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

fn described() -> (Router<HubView>, OpenApi) {
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
        .routes(routes!(events::stream))
        .routes(routes!(diag::archive))
        .routes(routes!(changes::set_threshold))
        .routes(routes!(changes::set_target))
        .routes(routes!(changes::changes))
        .routes(routes!(changes::change))
        .routes(routes!(changes::drift))
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
pub(crate) fn router(view: HubView) -> Router {
    let (router, _) = described();
    http::with_page(router, "hub.html")
        .route("/openapi.json", get(|| async { Json(openapi()) }))
        .with_state(view)
}
