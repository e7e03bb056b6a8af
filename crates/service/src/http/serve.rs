//! Adds the common layers to a router and serves it.

use super::auth::{Admitted, Guard, guard};
use super::problem;
use crate::ServiceError;
use crate::config::{HttpConfig, NamedToken};
use axum::Router;
use axum::body::{Body, HttpBody as _, to_bytes};
use axum::extract::{DefaultBodyLimit, Request};
use axum::http::header::{AUTHORIZATION, CONTENT_LENGTH, CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderValue, Method, StatusCode};
use axum::middleware::{from_fn_with_state, map_response};
use axum::response::Response;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::collections::VecDeque;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinSet};
use tokio_util::sync::CancellationToken;
use tower_http::classify::ServerErrorsFailureClass;
use tower_http::cors::CorsLayer;
use tower_http::timeout::TimeoutLayer;
use tower_http::trace::TraceLayer;
use tower_service::Service;

/// The largest request body, bytes. The largest legitimate one has about thirty.
pub(super) const BODY_LIMIT: usize = 16 << 10;

/// The time for requests in progress to end after the shutdown.
const GRACE: Duration = Duration::from_secs(1);

/// The pause before accepting again when no file descriptors are left.
const NO_DESCRIPTORS: Duration = Duration::from_millis(100);

/// Serves `router` on `listener` with authentication, limits and problem documents until `shutdown`, then gives
/// requests in progress at most a second to end (their router closes event streams). Pages of other origins may use
/// `methods`.
///
/// A connection that sends nothing, or does not read, for [`HttpConfig::idle_timeout_ms`] is closed. There are at most
/// [`HttpConfig::max_connections`]; at the limit, one is closed for a new one: the oldest of those without an admitted
/// request, or else the oldest. Changes in the file of one of the
/// `tokens`, or of the configuration's token, apply within a second or two.
///
/// # Errors
/// [`ServiceError`] if a token cannot be read, or if other machines can reach the listener and neither a token nor
/// `allow_unauthenticated` is set.
pub async fn run(
    config: &HttpConfig,
    tokens: &[NamedToken],
    methods: &[Method],
    router: Router,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), ServiceError> {
    let allowed = Guard::new(config, tokens, &listener)?;
    let follower = allowed.clone();
    let following = tokio::spawn(follower.follow_files(config.clone(), tokens.to_vec()));
    let router = layered(config, methods, router, allowed);
    let idle = Duration::from_millis(config.idle_timeout_ms);
    let mut serving = JoinSet::new();
    let mut open = Connections::default();
    loop {
        let accepted = tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            Some(_) = serving.join_next() => continue,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, _)) => {
                open.make_room(config.max_connections);
                let admitted = Admitted::default();
                let connection = serve(
                    stream,
                    idle,
                    router.clone(),
                    admitted.clone(),
                    shutdown.clone(),
                );
                open.add(serving.spawn(connection), admitted);
            }
            // The peer closed before the accept, or no file descriptors are left.
            Err(error) => {
                tracing::debug!(%error, "HTTP connection not accepted");
                tokio::time::sleep(NO_DESCRIPTORS).await;
            }
        }
    }
    drop(listener);
    following.abort();
    let ending = async { while serving.join_next().await.is_some() {} };
    if tokio::time::timeout(GRACE, ending).await.is_err() {
        tracing::warn!("HTTP connections still open after {GRACE:?} were cut off");
    }
    Ok(())
}

/// An open connection.
struct Connection {
    task: AbortHandle,
    admitted: Admitted,
}

/// The open connections, the oldest first.
#[derive(Default)]
struct Connections(VecDeque<Connection>);

impl Connections {
    fn add(&mut self, task: AbortHandle, admitted: Admitted) {
        self.0.push_back(Connection { task, admitted });
    }

    /// Closes a connection if there are `most`, so that clients that only hold connections cannot keep others out. One
    /// without an admitted request goes first, so that a client without a token cuts off none that has one. A page whose
    /// event stream is cut reopens it.
    fn make_room(&mut self, most: usize) {
        self.0.retain(|one| !one.task.is_finished());
        if self.0.len() < most {
            return;
        }
        let first_unproven = self.0.iter().position(|one| !one.admitted.is_set());
        let oldest = 0;
        if let Some(closed) = self.0.remove(first_unproven.unwrap_or(oldest)) {
            closed.task.abort();
        }
    }
}

/// Serves a connection until it ends or is idle for too long, or until its request in progress ends after `shutdown`.
async fn serve(
    stream: TcpStream,
    idle: Duration,
    router: Router,
    admitted: Admitted,
    shutdown: CancellationToken,
) {
    // Events are short and should not wait for more data.
    let _ = stream.set_nodelay(true);
    // The system closes a connection whose peer no longer reads.
    let limit_ms = u32::try_from(idle.as_millis()).unwrap_or(u32::MAX);
    if let Err(error) = rustix::net::sockopt::set_tcp_user_timeout(&stream, limit_ms) {
        tracing::debug!(%error, "an HTTP connection has no write limit");
    }
    let service = service_fn(move |request: Request<hyper::body::Incoming>| {
        let mut request = request.map(Body::new);
        request.extensions_mut().insert(admitted.clone());
        router.clone().call(request)
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(idle)
        .serve_connection(TokioIo::new(stream), service);
    tokio::pin!(connection);
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = shutdown.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "HTTP connection failed");
    }
}

fn layered(config: &HttpConfig, methods: &[Method], router: Router, allowed: Guard) -> Router {
    let limit = Duration::from_millis(config.timeout_ms);
    let inner = router
        .layer(DefaultBodyLimit::max(BODY_LIMIT))
        // Limits the time until a response begins. Event streams begin at once and stay open.
        .layer(TimeoutLayer::with_status_code(
            StatusCode::REQUEST_TIMEOUT,
            limit,
        ))
        .layer(from_fn_with_state(allowed, guard));
    // Axum adds the list of allowed methods outside all layers of its router; as the fallback of another
    // router, the whole answer is visible.
    let mut router = Router::new()
        .fallback_service(inner)
        .layer(from_fn_with_state(limit, problem::translate));
    if !config.cors_origins.is_empty() {
        let origins: Vec<HeaderValue> =
            config.cors_origins.iter().filter_map(|origin| origin.parse().ok()).collect();
        // Outermost, because a preflight request carries no token.
        router = router.layer(
            CorsLayer::new()
                .allow_origin(origins)
                .allow_methods(methods.to_vec())
                .allow_headers([AUTHORIZATION, CONTENT_TYPE]),
        );
    }
    // Without the query: a client may have put a secret in it by mistake.
    let trace = TraceLayer::new_for_http()
        .make_span_with(|request: &Request| {
            let method = request.method();
            let path = request.uri().path();
            tracing::info_span!("http", %method, path)
        })
        .on_failure(log_failure);
    router
        .layer(trace)
        .layer(map_response(believe_the_type))
        .layer(map_response(end_the_line))
}

/// Ends a JSON answer with a new line, so that a terminal's prompt does not stick to it.
async fn end_the_line(response: Response) -> Response {
    let media_type = response
        .headers()
        .get(CONTENT_TYPE)
        .and_then(|value| value.to_str().ok())
        .unwrap_or_default();
    // A stream has no exact size, and lines of its own.
    let is_whole = response.body().size_hint().exact().is_some();
    if !media_type.ends_with("json") || !is_whole {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    // It is the length without the new line, and not needed in the answer to a HEAD.
    parts.headers.remove(CONTENT_LENGTH);
    // It is in memory already: nothing can fail.
    let whole = to_bytes(body, usize::MAX).await.unwrap_or_default();
    if whole.is_empty() {
        return Response::from_parts(parts, Body::empty());
    }
    Response::from_parts(parts, Body::from([&whole[..], b"\n"].concat()))
}

/// Tells browsers to take an answer for what its content type says, whatever its bytes look like.
async fn believe_the_type(mut response: Response) -> Response {
    let value = HeaderValue::from_static("nosniff");
    response.headers_mut().insert(X_CONTENT_TYPE_OPTIONS, value);
    response
}

/// Logs a failed answer, unless it only says that the service is not ready: requests could otherwise fill the log, which
/// already has the reason once.
fn log_failure(failure: ServerErrorsFailureClass, latency: Duration, _span: &tracing::Span) {
    let is_not_ready = matches!(
        failure,
        ServerErrorsFailureClass::StatusCode(StatusCode::SERVICE_UNAVAILABLE)
    );
    if !is_not_ready {
        tracing::error!(%failure, ?latency, "an HTTP request failed");
    }
}
