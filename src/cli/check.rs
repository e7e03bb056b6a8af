//! `albireo check`: says what is wrong with a configuration file.

use super::block_on;
use albireo_node::config::NodeConfig;
use albireo_node::online::try_all;
use albireo_service::config::{ConfigError, examine};
use anyhow::bail;
use indicatif::ProgressBar;
use std::path::PathBuf;
use std::time::Duration;

const EXAMPLES: &str = "\
Looked at: every key and value, also of environment variables (ALBIREO_SECTION__KEY), and what this machine \
needs for it: models, class names, token, certificates, ONNX Runtime and its providers, the state directory. \
Ports that are taken now are told and no error: a running node has them. With --file-only this machine \
is not looked at. With --online also what is named is tried: the model is run on its provider, each source opened until
a picture comes, the router called, and a hub looked for behind it. A node may run meanwhile.

Exit code 0 when the configuration can be used (and everything tried works), 1 when not.

Examples:
  albireo check config/node.toml
  albireo check --online /etc/albireo/node.toml
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
    /// Also try what is named: model and provider, sources of cameras, router, hub.
    #[arg(long, conflicts_with = "file_only")]
    online: bool,
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
    if arguments.online {
        block_on(online(&config))?;
    }
    Ok(())
}

/// Tells a line for each thing that was tried.
async fn online(config: &NodeConfig) -> anyhow::Result<()> {
    // Seconds for a large model or a camera that is away, minutes for TensorRT's first engine.
    let waiting = ProgressBar::new_spinner().with_message("trying what is named");
    waiting.enable_steady_tick(Duration::from_millis(100));
    let mut failed = 0;
    try_all(config, |tried| {
        let line = match &tried.outcome {
            Ok(seen) => format!("works  {}: {seen}", tried.key),
            Err(reason) => {
                failed += 1;
                format!("fails  {}: {reason}", tried.key)
            }
        };
        waiting.suspend(|| println!("{line}"));
    })
    .await;
    waiting.finish_and_clear();
    match failed {
        0 => Ok(()),
        1 => bail!("one thing that is named does not work"),
        several => bail!("{several} things that are named do not work"),
    }
}
