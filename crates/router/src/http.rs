//! Serves health and metrics of a router.

use crate::probe::Probes;
use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use std::fmt::Write as _;
use std::sync::{Arc, OnceLock};
use zenoh::Session;

/// What the routes read.
#[derive(Clone, Debug)]
pub(crate) struct RouterView {
    pub(crate) probes: Probes,
    /// Once it is open.
    pub(crate) session: Arc<OnceLock<Session>>,
    pub(crate) max_sessions: u64,
}

impl RouterView {
    /// Sessions of others, once the router is open.
    async fn sessions(&self) -> Option<usize> {
        let session = self.session.get()?;
        Some(session.info().transports().await.count())
    }

    /// Why the router does not do its work; empty when it does.
    pub(crate) fn reason(&self) -> Option<String> {
        match self.session.get() {
            None => Some("it does not listen yet".to_owned()),
            Some(session) if session.is_closed() => Some("its session is closed".to_owned()),
            Some(_) => self.probes.stuck(),
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
    match view.reason() {
        None => Json(serde_json::json!({ "ready": true, "sessions": view.sessions().await }))
            .into_response(),
        Some(reason) => {
            albireo_service::http::Problem::new(StatusCode::SERVICE_UNAVAILABLE, reason)
                .into_response()
        }
    }
}

async fn metrics(State(view): State<RouterView>) -> Response {
    let sessions = view.sessions().await;
    let text = written(&view, sessions);
    (
        [(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")],
        text,
    )
        .into_response()
}

fn written(view: &RouterView, sessions: Option<usize>) -> String {
    let mut text = String::new();
    let mut family = |name: &str, kind: &str, help: &str, samples: &[(String, f64)]| {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
        for (labels, value) in samples {
            let _ = writeln!(text, "{name}{labels} {value}");
        }
    };
    let one = |value: f64| vec![(String::new(), value)];
    family(
        "albireo_router_build_info",
        "gauge",
        "The program that runs, always 1",
        &[(
            format!("{{version=\"{}\"}}", env!("CARGO_PKG_VERSION")),
            1.0,
        )],
    );
    family(
        "albireo_router_ready",
        "gauge",
        "Whether the router takes sessions",
        &one(f64::from(u8::from(view.reason().is_none()))),
    );
    family(
        "albireo_router_sessions",
        "gauge",
        "Sessions of nodes, hubs and other routers; absent before the router listens",
        &sessions.map_or_else(Vec::new, |sessions| one(sessions as f64)),
    );
    family(
        "albireo_router_sessions_limit",
        "gauge",
        "Most sessions: one more is refused",
        &one(view.max_sessions as f64),
    );
    family(
        "albireo_router_probe_seconds",
        "gauge",
        "How long it took to open a session at the last attempt; absent when it failed",
        &(view.probes.took()).map_or_else(Vec::new, |took| one(took.as_secs_f64())),
    );
    family(
        "albireo_router_probes_failed_total",
        "counter",
        "Attempts of the router to open a session to itself that failed",
        &one(view.probes.failed() as f64),
    );
    for figure in albireo_service::process::figures() {
        if figure.counter {
            let name = format!("{}_total", figure.name);
            family(&name, "counter", figure.help, &one(figure.value));
        } else {
            family(figure.name, "gauge", figure.help, &one(figure.value));
        }
    }
    text
}
