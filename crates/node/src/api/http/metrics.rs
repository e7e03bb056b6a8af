//! Metrics for Prometheus, in OpenMetrics text or in the older text format (0.0.4), as the reader asks.

mod audit;
mod cameras;
mod detector;
mod family;
mod node;
mod plain;
mod target;

use self::family::Page;
use self::plain::to_plain;
use super::RouteState;
use super::pictures::Pictures;
use crate::state::board::{Board, CameraBoard, CameraSnapshot};
use albireo_service::http::Problem;
use axum::extract::State;
use axum::http::header::{ACCEPT, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, text::encode};
use prometheus_client::registry::Registry;
use std::fmt;
use std::sync::Arc;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
const PLAIN: &str = "text/plain; version=0.0.4; charset=utf-8";

/// The registry over a board.
pub(super) struct Metrics(Registry);

impl Metrics {
    /// Metrics of that board, and of the pictures that were shown.
    pub(crate) fn new(board: Arc<Board>, pictures: &Pictures) -> Self {
        let mut registry = Registry::default();
        registry.register_collector(Box::new(ProcessCollector));
        let albireo = registry.sub_registry_with_prefix("albireo");
        albireo.register(
            "shown_pictures_decoded",
            "Pictures decoded because somebody looked at them",
            pictures.decoded().clone(),
        );
        albireo.register_collector(Box::new(BoardCollector(board)));
        Self(registry)
    }
}

/// Reads what the process uses at each scrape. Its names have no prefix: they are every program's.
#[derive(Debug)]
struct ProcessCollector;

impl Collector for ProcessCollector {
    fn encode(&self, encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let mut page = Page(encoder);
        for figure in albireo_service::process::figures() {
            match figure.counter {
                true => page.counter(figure.name, figure.help, figure.value)?,
                false => page.gauge(figure.name, figure.help, figure.value)?,
            }
        }
        Ok(())
    }
}

/// Reads the board at each scrape, so that no figure is kept twice.
#[derive(Debug)]
struct BoardCollector(Arc<Board>);

type Snapshots<'a> = [(&'a CameraBoard, CameraSnapshot)];

impl Collector for BoardCollector {
    fn encode(&self, encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let (mut page, board) = (Page(encoder), &self.0);
        let cameras: Vec<_> = (board.cameras().iter())
            .map(|camera| (&**camera, camera.snapshot()))
            .collect();
        node::node(&mut page, board)?;
        detector::detector(&mut page, board)?;
        cameras::cameras(&mut page, board, &cameras)?;
        audit::audit(&mut page, &cameras)?;
        target::target(&mut page, board)?;
        node::outbox(&mut page, board)?;
        node::power(&mut page, board)
    }
}

/// All metrics as OpenMetrics text.
///
/// # Errors
/// A problem document when they cannot be written.
pub(super) fn written(shared: &RouteState) -> Result<String, Problem> {
    let mut text = String::new();
    encode(&mut text, &shared.metrics.0).map_err(|error| {
        let detail = format!("the metrics cannot be written: {error}");
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, detail)
    })?;
    Ok(text)
}

/// Metrics for Prometheus
///
/// OpenMetrics text for a reader that accepts it, else the older text format.
/// `curl http://127.0.0.1:8080/metrics`
#[utoipa::path(
    get, operation_id = "metrics", path = "/metrics", tag = "metrics",
    responses((status = 200, content((String = "text/plain"), (String = "application/openmetrics-text"))))
)]
pub(super) async fn text(
    State(shared): State<RouteState>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let text = written(&shared)?;
    let accepted = headers.get_all(ACCEPT).iter();
    let open = (accepted.filter_map(|value| value.to_str().ok()))
        .any(|value| value.contains("application/openmetrics-text"));
    Ok(match open {
        true => ([(CONTENT_TYPE, OPEN_METRICS)], text).into_response(),
        false => ([(CONTENT_TYPE, PLAIN)], to_plain(&text)).into_response(),
    })
}
