//! `albireo node`: runs a node until it is told to stop.

use super::{logging, signals};
use crate::detector::DetectorStatus;
use crate::http::{self, NodeView};
use crate::node::board::{Board, BoardSetup};
use crate::node::config::NodeConfig;
use anyhow::Context;
use std::path::PathBuf;
use tokio::sync::watch;

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
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("the asynchronous runtime cannot be started")?
        .block_on(serve(config))
}

async fn serve(config: NodeConfig) -> anyhow::Result<()> {
    let shutdown = signals::shutdown().context("signals cannot be listened to")?;
    let listener = tokio::net::TcpListener::bind(config.http.listen)
        .await
        .with_context(|| format!("http.listen: {} cannot be listened on", config.http.listen))?;
    let address = listener.local_addr().context("http.listen")?;
    let (_detector, detector_status) = watch::channel(DetectorStatus::Starting);
    let view = NodeView {
        board: Board::new(BoardSetup::from_config(&config, detector_status)?),
        limits: config.frame,
    };
    tracing::info!(%address, node = config.node.name, "HTTP interface");
    http::run(&config.http, listener, view, shutdown).await?;
    Ok(())
}
