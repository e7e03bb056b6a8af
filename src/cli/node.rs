//! `albireo node`: runs a node until it is told to stop.

use super::{block_on, logging, signals};
use crate::http::{self, NodeView};
use crate::node::PreparedNode;
use crate::node::config::NodeConfig;
use anyhow::Context;
use std::path::PathBuf;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

const EXAMPLES: &str = "\
Without --config the built-in defaults hold; config/node.toml shows them all. Environment variables
override single keys: ALBIREO_ and section and key, with two underscores between them.
Ctrl-C or SIGTERM: the frame in hand is finished and the open clip published.

Examples:
  albireo node --config /etc/albireo/node.toml
  ALBIREO_POLICY__U=5e-4 ALBIREO_LOG__FORMAT=json albireo node --config node.toml";

/// Arguments of `albireo node`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// The node's configuration file.
    #[arg(long, short, env = "ALBIREO_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let config = NodeConfig::load(arguments.config.as_deref())?;
    logging::start(&config.log)?;
    block_on(serve(config))
}

async fn serve(config: NodeConfig) -> anyhow::Result<()> {
    let shutdown = signals::shutdown().context(signals::CONTEXT)?;
    let listener = TcpListener::bind(config.http.listen)
        .await
        .with_context(|| format!("http.listen: {} cannot be listened on", config.http.listen))?;
    run_node(&config, listener, shutdown).await
}

/// Runs a node and its HTTP interface on `listener` until `shutdown`.
///
/// HTTP answers first, so that a health check sees a node that is still loading its model; the node is
/// ready when its cameras can be heard.
///
/// # Errors
/// When a part of the node cannot start, or the HTTP interface may not be offered as configured.
pub async fn run_node(
    config: &NodeConfig,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> anyhow::Result<()> {
    let prepared = PreparedNode::new(config)?;
    run_prepared(config, prepared, listener, shutdown).await
}

/// As [`run_node`], with a node whose board somebody else looks at too.
pub(super) async fn run_prepared(
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
    let http = http::run(&config.http, listener, view, serving.clone());
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
