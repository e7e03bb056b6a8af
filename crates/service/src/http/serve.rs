//! Puts the common layers around a router and serves it.

use super::HttpError;
use super::auth::{Guard, guard};
use super::problem::{self, Problem};
use crate::config::{HttpConfig, NamedToken};
use axum::Router;
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::header::{AUTHORIZATION, CONTENT_TYPE};
use axum::http::{HeaderValue, Method, StatusCode};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tower_http::cors::CorsLayer;

/// Largest body of a request, bytes. The largest legitimate one has about thirty.
pub const BODY_LIMIT: usize = 16 << 10;

/// Time the requests in hand have to end after the shutdown.
const GRACE: Duration = Duration::from_secs(2);

/// Serves `router` on `listener` with authentication, limits and problem documents until `shutdown`, then lets
/// requests in hand end (event streams are closed by their router) for at most two seconds.
///
/// # Errors
/// [`HttpError`] when the token cannot be read, or the listener can be reached from other machines and
/// neither a token is set nor `allow_unauthenticated`.
pub async fn run(
    config: &HttpConfig,
    router: Router,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), HttpError> {
    run_with_tokens(config, &[], router, listener, shutdown).await
}

/// As [`run`], with named tokens beside the one of the configuration.
///
/// # Errors
/// As [`run`].
pub async fn run_with_tokens(
    config: &HttpConfig,
    tokens: &[NamedToken],
    router: Router,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), HttpError> {
    let allowed = Guard::new(config, tokens, &listener)?;
    let limit = Duration::from_millis(config.timeout_ms);
    let inner = router
        .fallback(problem::not_found)
        .layer(DefaultBodyLimit::max(BODY_LIMIT))
        .layer(from_fn_with_state(limit, within))
        .layer(from_fn_with_state(allowed, guard));
    // Axum puts the list of allowed methods on an answer outside all layers of its router; as the
    // fallback of another router the whole answer can be seen.
    let mut router = Router::new()
        .fallback_service(inner)
        .layer(from_fn(problem::translate));
    if !config.cors_origins.is_empty() {
        let origins: Vec<HeaderValue> = config
            .cors_origins
            .iter()
            .filter_map(|origin| origin.parse().ok())
            .collect();
        // Outermost, because a preflight request carries no token.
        router = router.layer(
            CorsLayer::new()
                .allow_origin(origins)
                .allow_methods([Method::GET, Method::PUT])
                .allow_headers([AUTHORIZATION, CONTENT_TYPE]),
        );
    }
    let stop = shutdown.clone();
    let server =
        axum::serve(listener, router).with_graceful_shutdown(async move { stop.cancelled().await });
    tokio::select! {
        ended = server.into_future() => ended.map_err(HttpError::Listener),
        () = async { shutdown.cancelled().await; tokio::time::sleep(GRACE).await } => {
            tracing::warn!("HTTP connections still open after {GRACE:?} were cut off");
            Ok(())
        }
    }
}

/// Bounds the time until a response begins. Event streams begin at once and then last.
async fn within(State(limit): State<Duration>, request: Request, next: Next) -> Response {
    match tokio::time::timeout(limit, next.run(request)).await {
        Ok(response) => response,
        Err(_) => Problem::new(
            StatusCode::REQUEST_TIMEOUT,
            format!("the request did not end within {limit:?}"),
        )
        .into_response(),
    }
}
