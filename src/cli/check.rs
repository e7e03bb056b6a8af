//! `albireo check`: says what is wrong with a configuration file.

use albireo_node::config::NodeConfig;
use albireo_service::config::{ConfigError, examine};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Looked at: every key and value, also of environment variables (ALBIREO_SECTION__KEY), and what this machine \
needs for it: models, class names, token, certificates, ONNX Runtime and its providers, the state directory. \
Ports that are taken now are told and no error: a running node has them. With --file-only this machine \
is not looked at. Not looked at: whether anybody answers.

Exit code 0 when the configuration can be used, 1 when not.

Examples:
  albireo check config/node.toml
  albireo check --file-only config/node.toml
  ALBIREO_HTTP__LISTEN=0.0.0.0:8080 albireo check config/node.toml";

/// Arguments of `albireo check`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// The node's configuration file.
    file: PathBuf,
    /// Look at keys and values alone: for a file that is meant for another machine.
    #[arg(long)]
    file_only: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = &arguments.file;
    let (config, mut findings) = examine::<NodeConfig>(Some(file));
    if let Some(config) = config.as_ref().filter(|_| !arguments.file_only) {
        let known: Vec<_> = findings.iter().map(|finding| finding.key.clone()).collect();
        let missing = config.missing_here().into_iter();
        findings.extend(missing.filter(|finding| !known.contains(&finding.key)));
    }
    let config = match config {
        Some(config) if findings.is_empty() => config,
        _ => {
            let file = file.display().to_string();
            return Err(ConfigError { file, findings }.into());
        }
    };
    println!(
        "{} can be used: node `{}`, {} camera{}",
        file.display(),
        config.node.name,
        config.cameras.len(),
        if config.cameras.len() == 1 { "" } else { "s" },
    );
    if !arguments.file_only {
        for finding in config.in_the_way() {
            println!("note: {finding} (by a running node?)");
        }
    }
    Ok(())
}
