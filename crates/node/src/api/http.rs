//! The HTTP routes of a node.

mod body;
mod cameras;
mod clips;
mod diag;
mod events;
mod health;
mod history;
mod metrics;
mod node;
mod picture;
mod policy;
mod recordings;
mod screen;
mod states;
mod target;
mod threshold;

pub(crate) use health::alive;

use crate::outbox::Outbox;
use crate::recorder::Recorder;
use crate::settings::Settings;
use crate::state::board::{Board, CameraBoard, DetectorEvent, FrameEvent, ThresholdEvent};
use albireo_service::http::{self, Problem};
use albireo_vision::picture::FrameLimits;
use albireo_wire::{
    CountersMessage, Desired, DetectionsMessage, FrameAnswer, FrameAttachment, PolicyMessage,
    ReportAnswer, ReportBatch, RevisionMessage, ScreenMessage, SettledMessage, Sighting,
    StatusMessage, ThresholdMessage,
};
use axum::http::StatusCode;
use axum::routing::get;
use axum::{Json, Router};
use events::OpenStreams;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use tokio::sync::{Mutex, Semaphore};
use tokio_util::sync::CancellationToken;
use utoipa::OpenApi as _;
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// State shared by all handlers.
#[derive(Clone)]
struct RouteState {
    board: Arc<Board>,
    settings: Arc<Settings>,
    outbox: Arc<Outbox>,
    recorder: Arc<Recorder>,
    /// Limits for decoding the latest picture of a camera that does not send JPEG.
    limits: FrameLimits,
    /// The configuration without its secrets.
    config: Arc<serde_json::Value>,
    /// Locked while a picture is decoded, so that memory holds one decoded picture at a time.
    decoding: Arc<Mutex<()>>,
    /// The number of pictures decoded for display.
    decoded: Arc<AtomicU64>,
    streams: Arc<OpenStreams>,
    /// Permits for picture streams.
    viewers: Arc<Semaphore>,
    shutdown: CancellationToken,
}

impl RouteState {
    fn camera_names(&self) -> Vec<String> {
        self.board.cameras.iter().map(|camera| camera.name().to_owned()).collect()
    }

    fn camera(&self, name: &str) -> Result<&Arc<CameraBoard>, Problem> {
        Ok(&self.board.cameras[self.camera_place(name)?])
    }

    /// The place of a camera in the configuration.
    fn camera_place(&self, name: &str) -> Result<usize, Problem> {
        self.board.camera_place(name).ok_or_else(|| {
            let names = self.camera_names();
            let detail = format!(
                "there is no camera `{name}`; there is: {}",
                names.join(", ")
            );
            Problem::new(StatusCode::NOT_FOUND, detail).allowing(names)
        })
    }
}

fn bad_request(detail: String) -> Problem {
    Problem::new(StatusCode::BAD_REQUEST, detail)
}

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "albireo node",
        description = "Watch a node and set its uncertainty threshold. Errors are problem documents (RFC 9457). \
                       If a token is set, every path requires it except `/` and what it loads, `/api/v1/caller`, `/healthz`, `/readyz`, `/openapi.json` and `/docs`.",
    ),
    components(schemas(
        Problem,
        // Messages in events and on Zenoh: the document can describe them, but not the contents of a stream.
        CountersMessage,
        DetectionsMessage,
        PolicyMessage,
        ScreenMessage,
        SettledMessage,
        Sighting,
        FrameAttachment,
        FrameAnswer,
        ReportBatch,
        ReportAnswer,
        StatusMessage,
        RevisionMessage,
        Desired,
        ThresholdMessage,
        FrameEvent,
        ThresholdEvent,
        DetectorEvent
    )),
    security((), ("token" = []))
)]
struct Description;

fn described() -> (Router<RouteState>, OpenApi) {
    let routes = OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(http::caller))
        .routes(routes!(node::overview))
        .merge(changing())
        .routes(routes!(states::all))
        .routes(routes!(states::one))
        .routes(routes!(node::index))
        .routes(routes!(cameras::list))
        .routes(routes!(cameras::one))
        .routes(routes!(cameras::detections))
        .routes(routes!(history::camera))
        .routes(routes!(history::skip_estimate))
        .routes(routes!(history::power))
        .routes(routes!(picture::jpeg))
        .routes(routes!(picture::mjpeg))
        .routes(routes!(clips::list))
        .routes(routes!(events::stream))
        .routes(routes!(diag::tail))
        .routes(routes!(diag::archive))
        .routes(routes!(metrics::text));
    let (router, mut openapi) = routes.split_for_parts();
    http::describe(&mut openapi);
    (router, openapi)
}

/// The routes by which the node is changed.
fn changing() -> OpenApiRouter<RouteState> {
    OpenApiRouter::new()
        .routes(routes!(policy::get, policy::put))
        .routes(routes!(threshold::get_all, threshold::put_all))
        .routes(routes!(threshold::get_one, threshold::put_one))
        .routes(routes!(target::get, target::put))
        .routes(routes!(screen::get, screen::put))
        .routes(routes!(recordings::get, recordings::put))
}

/// The node's OpenAPI document, as served at `/openapi.json`.
pub fn openapi() -> OpenApi {
    let (_, openapi) = described();
    openapi
}

/// What the routes show and change.
pub(crate) struct RouterSetup {
    /// The live state.
    pub board: Arc<Board>,
    /// Changed by requests.
    pub settings: Arc<Settings>,
    /// Its counts are shown.
    pub outbox: Arc<Outbox>,
    /// Records cameras at requests.
    pub recorder: Arc<Recorder>,
    /// Limits for decoding the latest picture of a camera that does not send JPEG.
    pub limits: FrameLimits,
    /// The configuration without its secrets.
    pub config: serde_json::Value,
}

/// The router of the node: all routes, their OpenAPI document and the page.
pub(crate) fn router(setup: RouterSetup, shutdown: CancellationToken) -> Router {
    let (router, document) = described();
    let router = http::refuse_unread_queries(router, document);
    #[cfg(feature = "swagger")]
    let router = router.merge(
        // The document is served below: this only gives its address to the page.
        utoipa_swagger_ui::SwaggerUi::new("/docs")
            .config(utoipa_swagger_ui::Config::new(["/openapi.json"])),
    );
    http::with_page(router, "node.html")
        .route("/openapi.json", get(|| async { Json(openapi()) }))
        .with_state(RouteState {
            board: setup.board,
            settings: setup.settings,
            outbox: setup.outbox,
            recorder: setup.recorder,
            limits: setup.limits,
            config: Arc::new(setup.config),
            decoding: Arc::default(),
            decoded: Arc::default(),
            streams: Arc::default(),
            viewers: Arc::new(Semaphore::new(picture::MOST_VIEWERS)),
            shutdown,
        })
}
