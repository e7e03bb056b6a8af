//! Runs a Zenoh router with health and metrics, from start to stop.

use crate::error::{RouterError, about, at, other};
use crate::http::{self, RouterView};
use crate::probe::Probes;
use albireo_service::config::{Finding, HttpConfig};
use albireo_service::identity::{self, Certificates, exposed};
use albireo_service::notify;
use albireo_service::readiness::{Fault, Readiness};
use albireo_service::session::{self, plain};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use zenoh::{Config, Wait};

/// The time limit for closing the session.
const STOP_LIMIT: Duration = Duration::from_secs(4);

/// The options of `albireo router`.
#[derive(Clone, Debug, clap::Args)]
pub struct RouterOptions {
    /// Zenoh's configuration file: endpoints, certificates, limits.
    #[arg(long, short, env = "ALBIREO_ROUTER_CONFIG", value_name = "FILE")]
    config: PathBuf,
    /// Access rules, as written by `albireo acl`.
    #[arg(long, env = "ALBIREO_ROUTER_ACCESS", value_name = "FILE")]
    access: Option<PathBuf>,
    /// Run without access rules although certificates are required: every certificate may do everything.
    #[arg(long, conflicts_with = "access")]
    no_access_control: bool,
    /// Address of health and metrics. Addresses other than loopback need a token.
    #[arg(
        long,
        env = "ALBIREO_ROUTER_HTTP",
        value_name = "ADDRESS",
        default_value = "127.0.0.1:8095"
    )]
    http: SocketAddr,
    /// File whose first line is the token required for metrics.
    #[arg(long, env = "ALBIREO_ROUTER_HTTP_TOKEN_FILE", value_name = "FILE")]
    http_token_file: Option<PathBuf>,
    /// Seconds between two attempts of the router to open a session to itself, as a node would.
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    probe_s: u64,
}

impl RouterOptions {
    /// Returns the router's Zenoh configuration.
    ///
    /// # Errors
    /// [`RouterError`] if a file cannot be read or Zenoh rejects its contents.
    pub fn zenoh(&self) -> Result<Config, RouterError> {
        let in_config = |error| about(&self.config, plain(&error));
        let mut config = Config::from_file(&self.config).map_err(in_config)?;
        config.insert_json5("mode", "\"router\"").map_err(in_config)?;
        if let Some(file) = &self.access {
            let text = std::fs::read_to_string(file).map_err(at(file))?;
            config
                .insert_json5("access_control", &text)
                .map_err(|error| about(file, plain(&error)))?;
        }
        if is_true(&config, "transport/link/tls/enable_mtls")
            && !is_true(&config, "access_control/enabled")
            && !self.no_access_control
        {
            return other(format!(
                "{} requires certificates (`enable_mtls`), but there are no access rules: every certificate, revoked ones \
                 included, could send in the name of any node and answer as a hub. Set the rules with --access (`albireo \
                 acl --output access.json` writes them), or allow everything with --no-access-control",
                self.config.display()
            ));
        }
        Ok(config)
    }

    /// Finds files with secrets that other users of this machine can read. Names none of a configuration that cannot be
    /// used, which [`zenoh`](Self::zenoh) explains.
    pub fn exposed_here(&self) -> Vec<Finding> {
        let config = self.zenoh().ok();
        let keys = config.iter().flat_map(|config| identity::tls_files(config, "private_key"));
        let token = self.http_token_file.clone().map(|file| ("--http-token-file".to_owned(), file));
        keys.chain(token).filter_map(|(key, file)| exposed(&key, &file)).collect()
    }

    /// Returns the HTTP configuration for health and metrics.
    pub fn http(&self) -> HttpConfig {
        HttpConfig {
            listen: self.http,
            token_file: self.http_token_file.clone(),
            ..HttpConfig::default()
        }
    }
}

/// Runs a router until `shutdown`, with health and metrics on `listener`.
///
/// # Errors
/// [`RouterError`] if a file or an endpoint cannot be used, or the HTTP interface is not allowed as configured.
pub async fn run(
    options: &RouterOptions,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), RouterError> {
    let config = options.zenoh()?;
    let http_config = options.http();
    let max_sessions = match config.get_json("transport/unicast/max_sessions") {
        Ok(number) => number.parse().ok(),
        Err(_) => None,
    };
    let view = RouterView {
        probes: Probes::default(),
        certificates: Certificates::read(identity::tls_files(&config, "certificate")),
        session: Arc::new(OnceLock::new()),
        max_sessions,
    };
    // Each ends the other: without its HTTP interface a router cannot be monitored, and without a router there is nothing to
    // monitor.
    let stop_serving = CancellationToken::new();
    let routes = http::routes(view.clone());
    let no_named_tokens = [];
    let methods = [axum::http::Method::GET];
    let stop = stop_serving.clone();
    let serving = async {
        let served = albireo_service::http::run(
            &http_config,
            &no_named_tokens,
            &methods,
            routes,
            listener,
            stop,
        )
        .await;
        shutdown.cancel();
        served
    };
    let routing = async {
        let routed = route(config, options, &view, &shutdown).await;
        stop_serving.cancel();
        routed
    };
    let (served, routed) = tokio::join!(serving, routing);
    routed?;
    Ok(served?)
}

/// True if the switch at `key` of Zenoh's configuration is on.
fn is_true(config: &Config, key: &str) -> bool {
    config.get_json(key).is_ok_and(|value| value == "true")
}

async fn route(
    config: Config,
    options: &RouterOptions,
    view: &RouterView,
    shutdown: &CancellationToken,
) -> Result<(), RouterError> {
    let router_config = config.clone();
    let access_control = is_true(&config, "access_control/enabled");
    let session = session::attempt(config).await.map_err(|reason| {
        let key = format!("listen/endpoints in {}", options.config.display());
        let reason = session::not_listening(&key, &reason).unwrap_or(reason);
        RouterError::Other(format!("the router cannot be opened: {reason}"))
    })?;
    let endpoints: Vec<String> =
        session.info().locators().await.iter().map(ToString::to_string).collect();
    // Set only once.
    let _ = view.session.set(session.clone());
    tracing::info!(
        zenoh = endpoints.join(" "),
        sessions = view.max_sessions,
        access_control,
        "ready"
    );
    let readiness = Readiness::default();
    let router_view = view.clone();
    readiness.probe("router", "", move || {
        router_view.fault().map(Fault::not_ready)
    });
    let certificates = view.certificates.clone();
    readiness.probe(identity::PART, "", move || {
        certificates.fault().map(Fault::degraded)
    });
    let following = tokio::spawn(view.certificates.clone().follow());
    let watching = tokio::spawn(readiness.clone().watch(Duration::from_secs(1)));
    let probes = view.probes.clone();
    let notifier = tokio::spawn(notify::run(
        move || (readiness.health().status(), probes.seen().stuck()),
        shutdown.clone(),
    ));
    if let Some(endpoint) = endpoints.first() {
        let period = Duration::from_secs(options.probe_s);
        let probing = view.probes.run(&router_config, endpoint, period);
        shutdown.run_until_cancelled(probing).await;
    }
    // Without an endpoint there was nothing to probe until now.
    shutdown.cancelled().await;
    let _ = notifier.await;
    following.abort();
    watching.abort();
    // On a thread of its own: a close that does not end then ends with the process.
    let closing = tokio::task::spawn_blocking(move || session.close().wait());
    let closed = tokio::time::timeout(STOP_LIMIT, closing).await;
    // In time, without a panic, and without an error of Zenoh.
    if !matches!(closed, Ok(Ok(Ok(())))) {
        tracing::warn!("the router's session was not closed cleanly");
    }
    Ok(())
}
