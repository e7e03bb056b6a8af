//! Serves the health and metrics of a router.

use crate::probe::Probes;
use albireo_service::identity::Certificates;
use albireo_service::metrics::MetricsPage;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use std::sync::{Arc, OnceLock};
use zenoh::Session;

/// The state that the routes read.
#[derive(Clone, Debug)]
pub(crate) struct RouterView {
    pub(crate) probes: Probes,
    pub(crate) certificates: Certificates,
    /// The router's session, once open.
    pub(crate) session: Arc<OnceLock<Session>>,
    /// Most sessions; `None` if the configuration says no number.
    pub(crate) max_sessions: Option<u64>,
}

impl RouterView {
    /// The number of sessions of others, once the router is open.
    async fn sessions(&self) -> Option<usize> {
        let session = self.session.get()?;
        Some(session.info().transports().await.count())
    }

    /// Why the router does not work; `None` if it does.
    pub(crate) fn fault(&self) -> Option<String> {
        match self.session.get() {
            None => Some("it does not listen yet".to_owned()),
            Some(session) if session.is_closed() => Some("its session is closed".to_owned()),
            Some(_) => self.probes.seen().stuck(),
        }
    }
}

pub(crate) fn routes(view: RouterView) -> Router {
    Router::new()
        .route("/healthz", get(healthz))
        .route("/readyz", get(readyz))
        .route("/metrics", get(metrics))
        .with_state(view)
}

async fn healthz() -> Json<serde_json::Value> {
    Json(serde_json::json!({ "status": "ok", "version": env!("CARGO_PKG_VERSION") }))
}

async fn readyz(State(view): State<RouterView>) -> Response {
    match view.fault() {
        None => {
            let sessions = view.sessions().await;
            let mut answer = serde_json::json!({ "ready": true, "sessions": sessions });
            if let Some(fault) = view.certificates.fault() {
                answer["reasons"] = serde_json::json!({ "certificates": fault });
            }
            Json(answer).into_response()
        }
        Some(fault) => albireo_service::http::Problem::new(StatusCode::SERVICE_UNAVAILABLE, fault)
            .into_response(),
    }
}

async fn metrics(State(view): State<RouterView>) -> MetricsPage {
    let mut page = MetricsPage::default();
    let seen = view.probes.seen();
    page.gauges(
        "albireo_router_build_info",
        "The running program, always 1",
        [([("version", env!("CARGO_PKG_VERSION"))], 1.0)],
    );
    page.gauge(
        "albireo_router_ready",
        "Whether the router accepts sessions",
        f64::from(u8::from(view.fault().is_none())),
    );
    page.gauge(
        "albireo_router_sessions",
        "Sessions of nodes, hubs and other routers; absent before the router listens",
        view.sessions().await.map(|sessions| sessions as f64),
    );
    page.gauge(
        "albireo_router_sessions_limit",
        "Most sessions; further ones are refused",
        view.max_sessions.map(|sessions| sessions as f64),
    );
    page.gauge(
        "albireo_router_probe_seconds",
        "Duration of the last attempt to open a session; absent if it failed",
        seen.took.map(|took| took.as_secs_f64()),
    );
    page.counter(
        "albireo_router_probes_failed_total",
        "Attempts of the router to open a session to itself that failed",
        seen.failed as f64,
    );
    page.process();
    page.certificates(&view.certificates);
    page
}
