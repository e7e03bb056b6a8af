//! Runs a Zenoh router with health and metrics, from start to stop.

use crate::error::{RouterError, about, at, other};
use crate::http::{self, RouterView};
use crate::probe::Probes;
use albireo_service::config::{
    ConfigError, EndpointUse, Finding, Findings, HttpConfig, check_endpoint,
};
use albireo_service::http::read_token;
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
        self.check_endpoints(&config)?;
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

    fn check_endpoints(&self, config: &Config) -> Result<(), RouterError> {
        let uses = [
            ("listen", EndpointUse::Listen),
            ("connect", EndpointUse::Connect),
        ];
        for (section, usage) in uses {
            for endpoint in session::endpoints(config, section) {
                if let Err(reason) = check_endpoint(&endpoint, usage) {
                    let reason = format!("{section}/endpoints: {reason}");
                    return Err(about(&self.config, reason));
                }
            }
        }
        Ok(())
    }

    /// Adds the errors in the options for HTTP.
    pub fn check(&self, findings: &mut Findings) {
        findings.path("--http-token-file", self.http_token_file.as_deref());
        if self.http().is_unprotected(&[]) {
            let reason = HttpConfig::unprotected(self.http, "set --http-token-file");
            findings.add("--http", reason);
        }
    }

    /// Looks for the files on this machine that the router reads when it starts; `config` is its configuration.
    ///
    /// # Errors
    /// Those that cannot be read.
    pub fn look_here(&self, config: &Config) -> Result<(), ConfigError> {
        let mut findings = Findings::default();
        for kind in ["certificate", "private_key"] {
            for (key, file) in identity::tls_files(config, kind) {
                let wrong = |error| format!("{} cannot be read: {error}", file.display());
                findings.check(key, std::fs::read(&file).map_err(wrong));
            }
        }
        if let Some(file) = &self.http_token_file {
            findings.check("--http-token-file", read_token(file));
        }
        if findings.0.is_empty() {
            return Ok(());
        }
        Err(ConfigError {
            file: self.config.display().to_string(),
            findings: findings.0,
        })
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// The options of a router with this configuration in `folder`.
    fn options(folder: &Path, config: &str) -> RouterOptions {
        let file = folder.join("router.json5");
        std::fs::write(&file, config).unwrap();
        RouterOptions {
            config: file,
            access: None,
            no_access_control: false,
            http: SocketAddr::from(([127, 0, 0, 1], 8095)),
            http_token_file: None,
            probe_s: 60,
        }
    }

    #[test]
    fn a_router_without_its_files_is_told_which_are_missing() {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("router.key");
        std::fs::write(&key, "").unwrap();
        let config = format!(
            r#"{{ listen: {{ endpoints: ["tls/127.0.0.1:7447"] }}, transport: {{ link: {{ tls: {{
            root_ca_certificate: "/nowhere/authority.pem", listen_certificate: "/nowhere/router.pem",
            listen_private_key: "{}" }} }} }} }}"#,
            key.display()
        );
        let mut options = options(folder.path(), &config);
        options.http_token_file = Some("/nowhere/token".into());
        let config = options.zenoh().unwrap();
        let missing = options.look_here(&config).unwrap_err();
        let keys: Vec<_> = missing.findings.iter().map(|one| one.key.as_str()).collect();
        assert_eq!(
            keys,
            [
                "listen_certificate",
                "root_ca_certificate",
                "--http-token-file"
            ]
        );
    }

    #[test]
    fn a_port_that_is_none_is_refused_before_the_router_starts() {
        let folder = tempfile::tempdir().unwrap();
        let config = r#"{ listen: { endpoints: ["tcp/127.0.0.1:99999"] } }"#;
        let refused = options(folder.path(), config).zenoh().err().unwrap();
        let reason = refused.to_string();
        assert!(reason.contains("listen/endpoints: `tcp/"), "{reason}");
        assert!(reason.contains("has the port `99999`"), "{reason}");
    }

    #[test]
    fn a_router_that_others_can_reach_is_told_of_an_option_that_it_has() {
        let folder = tempfile::tempdir().unwrap();
        let mut options = options(folder.path(), "{}");
        options.http = SocketAddr::from(([0, 0, 0, 0], 8095));
        let mut findings = Findings::default();
        options.check(&mut findings);
        let found = findings.0[0].to_string();
        let begin = "--http: 0.0.0.0:8095 can be reached";
        assert!(found.starts_with(begin), "{found}");
        assert!(found.ends_with("set --http-token-file"), "{found}");
    }
}
