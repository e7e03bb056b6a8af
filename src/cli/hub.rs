//! `albireo hub`: runs a hub until it is told to stop.

use super::block_on;
use albireo_hub::config::HubConfig;
use albireo_service::{config, logging, signals};
use anyhow::Context;
use std::path::PathBuf;
use tokio::net::TcpListener;

const EXAMPLES: &str = "\
Without --config the built-in defaults hold; config/hub.toml shows them all. Environment variables
override single keys: ALBIREO_ and section and key, with two underscores between them.
Ctrl-C or SIGTERM: the reports in hand are committed and acknowledged.

Examples:
  albireo hub --config /etc/albireo/hub.toml
  albireo hub --check --config config/hub.toml
  ALBIREO_DATABASE__URL=postgres://hub@db.example/fleet albireo hub";

/// Arguments of `albireo hub`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// The hub's configuration file.
    #[arg(long, short, env = "ALBIREO_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Only say what is wrong with the configuration. Exit code 0 when it can be used, 1 when not.
    #[arg(long)]
    check: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let config: HubConfig = config::load(arguments.config.as_deref())?;
    if arguments.check {
        println!(
            "the configuration can be used: nodes under `{}`, history in {}",
            config.hub.prefix,
            config.database.shown()
        );
        return Ok(());
    }
    logging::start(&config.log)?;
    block_on(serve(config))
}

async fn serve(config: HubConfig) -> anyhow::Result<()> {
    let shutdown = signals::shutdown().context(signals::CONTEXT)?;
    let listener = TcpListener::bind(config.http.listen)
        .await
        .with_context(|| format!("http.listen: {} cannot be listened on", config.http.listen))?;
    Ok(albireo_hub::run(&config, listener, shutdown).await?)
}
