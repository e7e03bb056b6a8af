//! `albireo router`: runs the router of a fleet until it is told to stop.

use super::block_on;
use albireo_router::RouterOptions;
use albireo_service::config::{Findings, HttpConfig, LogConfig, LogFormat};
use albireo_service::{logging, signals};
use anyhow::{Context, bail};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;
use tokio::net::TcpListener;

const EXAMPLES: &str = "\
A Zenoh router with health and metrics. Its configuration is Zenoh's own
(JSON5), which zenohd takes too; config/zenoh-router.json5 shows what a fleet
needs.

Examples:
  albireo router --config config/zenoh-router.json5
  albireo router --config /etc/albireo/router.json5 \\
      --access /etc/albireo/access.json
  curl http://127.0.0.1:8095/metrics";

/// Arguments of `albireo router`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Zenoh's configuration file: endpoints, certificates, limits.
    #[arg(long, short, env = "ALBIREO_ROUTER_CONFIG", value_name = "FILE")]
    config: PathBuf,
    /// Who may do what, as `albireo acl` writes it.
    #[arg(long, env = "ALBIREO_ROUTER_ACCESS", value_name = "FILE")]
    access: Option<PathBuf>,
    /// Run without access rules although certificates are asked for: every certificate may do everything.
    #[arg(long, conflicts_with = "access")]
    no_access_control: bool,
    /// Where health and metrics are. Other than loopback needs a token.
    #[arg(
        long,
        env = "ALBIREO_ROUTER_HTTP",
        value_name = "ADDRESS",
        default_value = "127.0.0.1:8095"
    )]
    http: SocketAddr,
    /// File whose first line is the token that metrics need.
    #[arg(long, env = "ALBIREO_ROUTER_HTTP_TOKEN_FILE", value_name = "FILE")]
    http_token_file: Option<PathBuf>,
    /// Seconds between two attempts of the router to open a session to itself, as a node would.
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    probe_s: u64,
    /// Write the log as JSON, one object a line.
    #[arg(long, env = "ALBIREO_ROUTER_LOG_JSON")]
    log_json: bool,
    /// Error, warn, info, debug, trace, or filter directives.
    #[arg(long, env = "ALBIREO_ROUTER_LOG_LEVEL", default_value = "info")]
    log_level: String,
    /// Only say what is wrong with the files. Exit code 0 when they can be used, 1 when not.
    #[arg(long)]
    check: bool,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let http = HttpConfig {
        listen: arguments.http,
        token_file: arguments.http_token_file,
        ..HttpConfig::default()
    };
    let log = LogConfig {
        format: if arguments.log_json {
            LogFormat::Json
        } else {
            LogFormat::Human
        },
        level: arguments.log_level,
    };
    let mut findings = Findings::default();
    http.check(&[], &mut findings);
    log.check(&mut findings);
    if let Some(finding) = findings.into_vec().first() {
        bail!("{finding}");
    }
    let options = RouterOptions {
        config: arguments.config,
        access: arguments.access,
        no_access_control: arguments.no_access_control,
        http,
        probe_every: Duration::from_secs(arguments.probe_s),
    };
    if arguments.check {
        options.zenoh()?;
        println!("the files can be used");
        return Ok(());
    }
    logging::start(&log)?;
    block_on(async {
        let shutdown = signals::shutdown().context(signals::CONTEXT)?;
        let listen = options.http.listen;
        let listener = TcpListener::bind(listen)
            .await
            .with_context(|| format!("--http: {listen} cannot be listened on"))?;
        Ok(albireo_router::run(&options, listener, shutdown).await?)
    })
}
