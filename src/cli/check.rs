//! `albireo check`: says what is wrong with a configuration file.

use albireo_node::config::NodeConfig;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Environment variables (ALBIREO_SECTION__KEY) are looked at too, as `albireo node` would.
Exit code 0 when the file can be used, 1 when not.

Examples:
  albireo check config/node.toml
  ALBIREO_HTTP__LISTEN=0.0.0.0:8080 albireo check config/node.toml";

/// Arguments of `albireo check`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// The node's configuration file.
    file: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let config: NodeConfig = albireo_service::config::load(Some(&arguments.file))?;
    println!(
        "{} can be used: node `{}`, {} camera{}",
        arguments.file.display(),
        config.node.name,
        config.cameras.len(),
        if config.cameras.len() == 1 { "" } else { "s" },
    );
    println!(
        "Looked at: every key and value. Not looked at: whether models, tokens, class names and folders are there, \
         whether ports are free, and whether anybody answers."
    );
    Ok(())
}
