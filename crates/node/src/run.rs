//! The service: a node and its HTTP interface, from start to stop.

use crate::PreparedNode;
use crate::config::NodeConfig;
use crate::http::{self, NodeView};
use anyhow::Context;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// Runs a node and its HTTP interface on `listener` until `shutdown`.
///
/// HTTP answers first, so that a health check sees a node that is still loading its model; the node is
/// ready when its cameras can be heard.
///
/// # Errors
/// When a part of the node cannot start, or the HTTP interface may not be offered as configured.
pub async fn run(
    config: &NodeConfig,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> anyhow::Result<()> {
    let prepared = PreparedNode::new(config)?;
    run_prepared(config, prepared, listener, shutdown).await
}

/// As [`run`], with a node whose board somebody else looks at too.
pub async fn run_prepared(
    config: &NodeConfig,
    prepared: PreparedNode,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> anyhow::Result<()> {
    let address = listener
        .local_addr()
        .context("the listener has no address")?;
    let view = NodeView {
        board: Arc::clone(prepared.board()),
        limits: config.frame,
    };
    // HTTP outlives the node, so that a look at the counters is possible until the end.
    let serving = CancellationToken::new();
    let http = albireo_service::http::run(
        &config.http,
        http::router(view, serving.clone()),
        listener,
        serving.clone(),
    );
    tracing::info!(
        http = format!("http://{address}"),
        node = config.node.name,
        "listening"
    );
    let node = async {
        let node = prepared.start(config, shutdown.clone()).await;
        let ended = match node {
            Ok(None) => Ok(()),
            Ok(Some(node)) => {
                let zenoh = node.endpoints().await;
                tracing::info!(?zenoh, cameras = config.cameras.len(), "ready");
                node.stopped().await;
                Ok(())
            }
            Err(error) => Err(error),
        };
        serving.cancel();
        ended
    };
    let (http, node) = tokio::join!(
        async {
            let ended = http.await.context("[http]");
            // Without its interface a node cannot be watched or stopped: it ends.
            shutdown.cancel();
            ended
        },
        node
    );
    node.and(http)
}
