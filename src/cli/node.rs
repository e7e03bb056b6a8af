//! `albireo node`: runs a node until it is stopped.

use super::{block_on, listen};
use albireo_node::config::NodeConfig;
use albireo_service::{logging, signals};
use std::path::{Path, PathBuf};

/// Arguments of `albireo node`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Without --config the built-in defaults apply; config/node.toml lists them all.
An environment variable overrides a single key: ALBIREO_SECTION__KEY, with two
underscores between section and key. RUST_LOG overrides log.level. Ctrl-C or
SIGTERM stops it, after the current frame is finished and the open clip
reported.

Examples:
  albireo node --config /etc/albireo/node.toml
  ALBIREO_POLICY__U=5e-4 ALBIREO_LOG__FORMAT=json albireo node \\
      --config node.toml")]
pub(super) struct NodeArguments {
    /// The node's configuration file.
    #[arg(long, short, env = "ALBIREO_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(super) fn run(arguments: &NodeArguments) -> anyhow::Result<()> {
    let mut config = configuration(arguments.config.as_deref())?;
    // Only measurements wait until TensorRT has built its engine.
    config.detector.answers_while_building = true;
    logging::start(&config.log)?;
    let defaults = Path::new("built-in defaults");
    let file = arguments.config.as_deref().unwrap_or(defaults).display();
    tracing::info!(version = env!("CARGO_PKG_VERSION"), configuration = %file, "starting");
    for finding in config.exposed_here(arguments.config.as_deref()) {
        tracing::warn!("{finding}");
    }
    block_on(async {
        let limit = config.node.stop_timeout;
        let shutdown = signals::shutdown_within(limit)?;
        let listener = listen("http.listen", config.http.listen).await?;
        let prepared = None;
        Ok(albireo_node::run(&config, prepared, listener, shutdown).await?)
    })
}

/// Returns the configuration of `file`, or the defaults, with the overrides of the environment.
pub(super) fn configuration(file: Option<&Path>) -> anyhow::Result<NodeConfig> {
    #[cfg_attr(not(feature = "development"), expect(unused_mut))]
    let mut config: NodeConfig = albireo_service::config::load(file)?;
    #[cfg(feature = "development")]
    super::development::apply(&mut config)?;
    Ok(config)
}
