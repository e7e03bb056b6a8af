//! The service: a node and its HTTP interface, from start to stop.

use crate::api::http;
use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::start::{Node, PreparedNode};
use crate::state::board::Board;
use crate::state::readiness;
use albireo_service::ServiceError;
use albireo_service::http::Problem;
use albireo_vision::detector::ExecutionProvider;
use axum::Router;
use axum::extract::Request;
use axum::http::{Method, StatusCode};
use axum::routing::get;
use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tower_service::Service;

/// Runs a node and its HTTP interface on `listener` until `shutdown`. The node is `prepared` if others also read its
/// board.
///
/// HTTP answers first, so that health checks work while the node opens its state file, connects or loads its model; the
/// node is ready once its cameras' frames can be received.
///
/// # Errors
/// [`NodeError`] if a part of the node cannot start, an essential task fails, or the HTTP interface is not allowed as
/// configured.
pub async fn run(
    config: &NodeConfig,
    prepared: Option<PreparedNode>,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), NodeError> {
    let address = listener.local_addr().map_err(NodeError::of("the listener has no address"))?;

    // HTTP outlives the node, so that the counters can be read until the end.
    let serving = CancellationToken::new();
    let _until_the_end = serving.clone().drop_guard();
    let routes = Arc::<OnceLock<Router>>::default();
    let served = serve(config, listener, Arc::clone(&routes), serving.clone());

    let Some(prepared) = prepare(config, prepared, &shutdown).await? else {
        return Ok(());
    };
    let board = Arc::clone(prepared.board());
    // Set only here.
    let _ = routes.set(prepared.router(config, serving.clone()));

    // A node without its interface cannot be monitored or stopped, so it ends.
    let unserved = shutdown.clone();
    let http = async move {
        let ended = served.await;
        unserved.cancel();
        ended
            .map_err(NodeError::of("the HTTP interface failed"))?
            .map_err(NodeError::of("[http]"))
    };

    let stopping = shutdown.child_token();
    let notifier = notify(Arc::clone(&board), config, stopping.clone());

    tracing::info!(
        http = format!("http://{address}"),
        node = config.node.name,
        "listening"
    );
    let node = async {
        // Loading a model may take minutes, or hang.
        let starting = prepared.start(config, shutdown.clone());
        let ended = match shutdown.run_until_cancelled(starting).await {
            None => {
                tracing::info!("stopped before the node was ready");
                Ok(())
            }
            Some(Ok(node)) => {
                let zenoh = node.endpoints().await;
                log_start(config, &board, &node, address, &zenoh);
                node.stopped().await
            }
            Some(Err(error)) => Err(error),
        };
        serving.cancel();
        ended
    };
    let (http, node) = tokio::join!(http, node);
    // Notifies the service manager of the end, even after an error, before the process exits.
    stopping.cancel();
    let _ = notifier.await;
    node.and(http)
}

/// Serves the `routes` once they are set, and until then those of a node that is opening its state directory. In a separate
/// task: nothing that the node waits for may delay a health check.
fn serve(
    config: &NodeConfig,
    listener: TcpListener,
    routes: Arc<OnceLock<Router>>,
    stop: CancellationToken,
) -> JoinHandle<Result<(), ServiceError>> {
    let early = early_routes(&config.node.name);
    let router = Router::new()
        .fallback(move |request: Request| routes.get().unwrap_or(&early).clone().call(request));
    let http = config.http.clone();
    let tokens = config.tokens.clone();
    tokio::spawn(async move {
        let methods = [Method::GET, Method::PUT];
        albireo_service::http::run(&http, &tokens, &methods, router, listener, stop).await
    })
}

/// Prepares the node, unless that is done; `None` if it is stopped before.
async fn prepare(
    config: &NodeConfig,
    prepared: Option<PreparedNode>,
    shutdown: &CancellationToken,
) -> Result<Option<PreparedNode>, NodeError> {
    if prepared.is_some() {
        return Ok(prepared);
    }
    // On a blocking thread, because opening and checking the state file takes a while on a slow SD card.
    let opened = config.clone();
    let opening = tokio::task::spawn_blocking(move || PreparedNode::new(&opened));
    match shutdown.run_until_cancelled(opening).await {
        Some(opened) => opened.map_err(NodeError::new)?.map(Some),
        None => Ok(None),
    }
}

/// Tells the service manager how the node is, until `stopping`.
fn notify(board: Arc<Board>, config: &NodeConfig, stopping: CancellationToken) -> JoinHandle<()> {
    let stuck_after_s = config.node.stuck_after_s;
    let builds_engine = config.detector.providers.contains(&ExecutionProvider::TensorRt);
    let state = move || {
        let detector = board.detector_status();
        let state =
            readiness::service_state(&board.readiness, &detector, stuck_after_s, builds_engine);
        (state.health, state.stuck)
    };
    tokio::spawn(albireo_service::notify::run(state, stopping))
}

/// Answers requests until the state file is open.
fn early_routes(node: &str) -> Router {
    let node = node.to_owned();
    let alive = || async move { http::alive(&node, Duration::ZERO) };
    let opening = || async {
        let reason = "the state directory is being opened";
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, reason)
    };
    Router::new().route("/healthz", get(alive)).fallback(opening)
}

/// Logs the main facts in one line.
fn log_start(config: &NodeConfig, board: &Board, node: &Node, http: SocketAddr, zenoh: &[String]) {
    let from: Vec<_> = board
        .cameras
        .iter()
        .map(|camera| camera.source.as_deref().unwrap_or(&camera.key))
        .collect();
    let thresholds: BTreeSet<_> = board
        .cameras
        .iter()
        .filter_map(|camera| camera.threshold_in_force())
        .map(|threshold| threshold.to_string())
        .collect();
    tracing::info!(
        version = env!("CARGO_PKG_VERSION"),
        node = config.node.name,
        policy = board.policy().name,
        threshold = thresholds.into_iter().collect::<Vec<_>>().join(", "),
        model = %config.detector.model.display(),
        provider = node.provider(),
        cameras = from.len(),
        from = from.join(" "),
        http = format!("http://{http}"),
        zenoh = zenoh.join(" "),
        state_dir = config.node.state_dir.as_ref().map_or_else(
            || "none".to_owned(),
            |folder| folder.display().to_string()
        ),
        "ready"
    );
}
