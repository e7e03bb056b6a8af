//! `albireo node`: runs a node until it is told to stop.

use super::{logging, signals};
use crate::node::config::NodeConfig;
use anyhow::Context;
use std::path::PathBuf;

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
    tracing::info!(address = %listener.local_addr()?, node = config.node.name, "listening");
    shutdown.cancelled().await;
    Ok(())
}
