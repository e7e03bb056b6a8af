//! `albireo router`: runs the router of a fleet until it is stopped.

use super::{block_on, listen};
use albireo_router::RouterOptions;
use albireo_service::config::{Findings, LogConfig, LogFormat};
use albireo_service::{logging, signals};
use anyhow::bail;

/// Arguments of `albireo router`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
A Zenoh router with health and metrics. Its configuration is Zenoh's own
(JSON5), as for zenohd; config/zenoh-router.json5 shows what a fleet needs.

Examples:
  albireo router --config config/zenoh-router.json5
  albireo router --config /etc/albireo/router.json5 \\
      --access /etc/albireo/access.json
  curl http://127.0.0.1:8095/metrics")]
pub(super) struct RouterArguments {
    #[command(flatten)]
    options: RouterOptions,
    /// Write the log as JSON, one object per line.
    #[arg(long, env = "ALBIREO_ROUTER_LOG_JSON")]
    log_json: bool,
    /// Log level (error, warn, info, debug, trace), or filter directives.
    #[arg(long, env = "ALBIREO_ROUTER_LOG_LEVEL", default_value = "info")]
    log_level: String,
    /// Only check the files. The exit code is 0 if they can be used, and 1 if not.
    #[arg(long)]
    check: bool,
    /// Check only what the configuration says, not the files that it names: for one that is meant for another machine.
    #[arg(long, requires = "check")]
    file_only: bool,
}

pub(super) fn run(arguments: RouterArguments) -> anyhow::Result<()> {
    let options = arguments.options;
    let http = options.http();
    let format = if arguments.log_json {
        LogFormat::Json
    } else {
        LogFormat::Human
    };
    let level = arguments.log_level;
    let log = LogConfig { format, level };
    let mut findings = Findings::default();
    options.check(&mut findings);
    log.check(&mut findings);
    if let Some(finding) = findings.0.first() {
        bail!("{finding}");
    }
    if arguments.check {
        let config = options.zenoh()?;
        if !arguments.file_only {
            options.look_here(&config)?;
        }
        println!("the files can be used");
        for finding in options.exposed_here() {
            println!("note: {finding}");
        }
        return Ok(());
    }
    logging::start(&log)?;
    for finding in options.exposed_here() {
        tracing::warn!("{finding}");
    }
    block_on(async {
        let shutdown = signals::shutdown()?;
        let listener = listen("--http", http.listen).await?;
        Ok(albireo_router::run(&options, listener, shutdown).await?)
    })
}
