//! The HTTP interface: what the routers of node and hub share, and one folder for each of them.

mod auth;
mod node;
mod problem;
mod serve;

pub use auth::TokenError;
pub use node::NodeView;
pub use problem::Problem;
pub use serve::HttpError;

use crate::node::config::HttpConfig;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// Serves a node's HTTP interface until `shutdown`, then lets requests in hand end (event streams are
/// closed) for at most two seconds.
///
/// # Errors
/// [`HttpError`] when the token cannot be read, or the listener can be reached from other machines and
/// neither a token is set nor `allow_unauthenticated`.
pub async fn run(
    config: &HttpConfig,
    listener: TcpListener,
    view: NodeView,
    shutdown: CancellationToken,
) -> Result<(), HttpError> {
    let guard = auth::Guard::new(config, &listener)?;
    let router = node::router(view, shutdown.clone());
    serve::serve(config, guard, router, listener, shutdown).await
}

/// The OpenAPI document of a node, as `/openapi.json` gives it.
pub fn node_openapi() -> utoipa::openapi::OpenApi {
    node::openapi()
}
