//! `albireo check`: lists the mistakes in the configuration file of a node or a hub.

use super::block_on;
use super::progress::spinner;
use super::terminal::print;
use super::values::counted;
use albireo_node::config::NodeConfig;
use albireo_node::online::try_all;
use albireo_service::config::{ConfigError, Finding, examine};
use anyhow::bail;
use std::path::PathBuf;
#[cfg(feature = "hub")]
use {
    albireo_hub::config::HubConfig, albireo_hub::store::check_here,
    albireo_service::config::Findings,
};

/// Arguments of `albireo check`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
A file with the section [hub] or [database] configures a hub, any other a node.
The command checks every key and value, including those from environment
variables (ALBIREO_SECTION__KEY). For a node it also checks what the node needs
on this machine: models, class names, token, certificates, ONNX Runtime and its
providers, the state directory; for a hub the tokens and the SQLite file. A port
in use is a note, not an error, because the node may be running.

The exit code is 0 if the configuration can be used (and everything tried
works), else 1.

Examples:
  albireo check config/node.toml
  albireo check config/hub.toml
  albireo check --online /etc/albireo/node.toml
  albireo check --file-only config/node.toml
  ALBIREO_HTTP__LISTEN=0.0.0.0:8080 albireo check config/node.toml")]
pub(super) struct CheckArguments {
    /// Configuration file of a node or a hub.
    file: PathBuf,
    /// Check keys and values only: for a file that is meant for another machine.
    #[arg(long)]
    file_only: bool,
    /// Also try what a node's file names: run the model on its provider, open each source until a picture arrives,
    /// connect to the router and look for a hub behind it.
    #[arg(long, conflicts_with = "file_only")]
    online: bool,
}

pub(super) fn run(arguments: &CheckArguments) -> anyhow::Result<()> {
    #[cfg(feature = "hub")]
    if is_for_a_hub(&arguments.file) {
        return check_hub(arguments);
    }
    let (config, mut findings) = examine::<NodeConfig>(Some(&arguments.file));
    let mut detector = None;
    let mut tried = Ok(());
    if let Some(config) = &config {
        if !arguments.file_only {
            let here = config.here();
            add_missing(&mut findings, here.missing);
            detector = here.detector;
        }
        // Also if something is missing: what else does not work is better known at once.
        if arguments.online {
            tried = block_on(online(config, &findings));
        }
    }
    let file = arguments.file.display().to_string();
    let config = match config {
        Some(config) if findings.is_empty() => config,
        _ => return Err(ConfigError { file, findings }.into()),
    };
    tried?;
    print(&format!(
        "{file} can be used: node `{}`, {}",
        config.node.name,
        counted(config.cameras.len() as u64, "camera", "cameras"),
    ));
    if let Some(detector) = &detector {
        // The trial has said the same.
        if !arguments.online {
            let model = config.detector.model.display();
            print(&format!("the detector {model}: {}", detector.description));
        }
        if let Some(note) = &detector.wasteful {
            print(&format!("note: detector.model: {note}"));
        }
    }
    if !arguments.file_only {
        for finding in config.in_the_way() {
            print(&format!("note: {finding} (by a running node?)"));
        }
        for finding in config.exposed_here(Some(&arguments.file)) {
            print(&format!("note: {finding}"));
        }
        for fault in [config.certificate_fault(), config.position_fault()].iter().flatten() {
            print(&format!("note: {fault}"));
        }
    }
    Ok(())
}

/// Returns true if a file has a section that only a hub's configuration has.
#[cfg(feature = "hub")]
fn is_for_a_hub(file: &std::path::Path) -> bool {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.lines()
        .filter_map(|line| line.trim().strip_prefix('['))
        .filter_map(|rest| rest.split(']').next())
        .any(|name| matches!(name.trim(), "hub" | "database"))
}

/// Adds what is missing on this machine, but for keys that have an error already.
fn add_missing(findings: &mut Vec<Finding>, missing: Vec<Finding>) {
    let known: Vec<_> = findings.iter().map(|finding| finding.key.clone()).collect();
    for finding in missing {
        if !known.contains(&finding.key) {
            findings.push(finding);
        }
    }
}

#[cfg(feature = "hub")]
fn check_hub(arguments: &CheckArguments) -> anyhow::Result<()> {
    if arguments.online {
        bail!("--online tries what a node's file names; this is a hub's file");
    }
    let (config, mut findings) = examine::<HubConfig>(Some(&arguments.file));
    if let Some(config) = &config
        && !arguments.file_only
    {
        let mut here = Findings(config.here());
        here.check("database.url", check_here(&config.database));
        add_missing(&mut findings, here.0);
    }
    let file = arguments.file.display().to_string();
    let config = match config {
        Some(config) if findings.is_empty() => config,
        _ => return Err(ConfigError { file, findings }.into()),
    };
    print(&format!(
        "{file} can be used: a hub for the nodes under `{}`, with the database {}",
        config.hub.prefix,
        config.database.shown()
    ));
    if !arguments.file_only {
        for finding in config.exposed_here(Some(&arguments.file)) {
            print(&format!("note: {finding}"));
        }
    }
    Ok(())
}

/// Tries each resource that the configuration names, and prints a line for each. A reason that `findings` repeat is
/// left to them.
///
/// # Errors
/// When one of the resources does not work.
async fn online(config: &NodeConfig, findings: &[Finding]) -> anyhow::Result<()> {
    // This takes seconds for a large model or an unreachable camera, and minutes for TensorRT's first engine.
    let waiting = spinner("trying models, cameras and router".to_owned());
    if waiting.is_hidden() {
        eprintln!("{} …", waiting.message());
    }
    let mut failed = 0;
    try_all(config, |key, outcome| {
        let line = match outcome {
            Ok(found) => format!("works  {key}: {found}"),
            Err(reason) => {
                failed += 1;
                let same = findings.iter().find(|finding| finding.reason == reason);
                match same {
                    Some(finding) => format!("fails  {key}: see {} below", finding.key),
                    None => format!("fails  {key}: {reason}"),
                }
            }
        };
        waiting.suspend(|| print(&line));
    })
    .await;
    waiting.finish_and_clear();
    match failed {
        0 => Ok(()),
        1 => bail!("one of these does not work"),
        several => bail!("{several} of these do not work"),
    }
}
