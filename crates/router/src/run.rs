//! Runs a Zenoh router with health and metrics, from start to stop.

use crate::http::{self, RouterView};
use crate::probe::Probes;
use albireo_service::config::HttpConfig;
use albireo_service::http::HttpError;
use albireo_service::notify::{self, ServiceState};
use albireo_service::session::plain;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use zenoh::{Config, Wait};

/// How long the session may take to close.
const STOP_LIMIT: Duration = Duration::from_secs(4);

/// What a router runs with.
#[derive(Clone, Debug)]
pub struct RouterOptions {
    /// Zenoh's configuration file: endpoints, certificates, limits.
    pub config: PathBuf,
    /// The section `access_control` that goes in it, as `albireo acl` writes it.
    pub access: Option<PathBuf>,
    /// Whether every certificate of the authority may do everything, revoked ones included.
    pub no_access_control: bool,
    /// Health and metrics.
    pub http: HttpConfig,
    /// Time between two attempts to open a session to itself.
    pub probe_every: Duration,
}

/// Why a router does not run.
#[derive(Debug, thiserror::Error)]
pub enum RouterError {
    /// A file cannot be used.
    #[error("{file}: {reason}")]
    File {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Certificates are asked for, and nothing says what their holders may do.
    #[error(
        "{0} asks for certificates (`enable_mtls`), and no access rules say what their holders may do: every certificate, \
         revoked ones included, could send in the name of any node and answer as a hub. Name the rules with --access \
         (`albireo acl --output access.json` writes them), or allow everything with --no-access-control"
    )]
    NoAccessRules(PathBuf),
    /// It cannot listen.
    #[error("the router cannot be opened: {0}")]
    NotOpened(String),
    /// Its HTTP interface may not be offered as configured.
    #[error("[http] {0}")]
    Http(#[from] HttpError),
}

impl RouterOptions {
    /// Zenoh's configuration of it.
    ///
    /// # Errors
    /// When a file cannot be read, or Zenoh does not take what is in it.
    pub fn zenoh(&self) -> Result<Config, RouterError> {
        let wrong = |file: &PathBuf| {
            let file = file.clone();
            |reason: String| RouterError::File { file, reason }
        };
        let mut config =
            Config::from_file(&self.config).map_err(|error| wrong(&self.config)(plain(&error)))?;
        config
            .insert_json5("mode", "\"router\"")
            .map_err(|error| wrong(&self.config)(plain(&error)))?;
        if let Some(file) = &self.access {
            let text =
                std::fs::read_to_string(file).map_err(|error| wrong(file)(error.to_string()))?;
            config
                .insert_json5("access_control", &text)
                .map_err(|error| wrong(file)(plain(&error)))?;
        }
        let is = |key: &str| config.get_json(key).is_ok_and(|value| value == "true");
        if is("transport/link/tls/enable_mtls")
            && !is("access_control/enabled")
            && !self.no_access_control
        {
            return Err(RouterError::NoAccessRules(self.config.clone()));
        }
        Ok(config)
    }
}

/// Runs a router until `shutdown`; health and metrics are on `listener`.
///
/// # Errors
/// When a file cannot be used, an endpoint cannot be listened on, or the HTTP interface may not be offered.
pub async fn run(
    options: &RouterOptions,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), RouterError> {
    let config = options.zenoh()?;
    let max_sessions = config
        .get_json("transport/unicast/max_sessions")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(0);
    let view = RouterView {
        probes: Probes::default(),
        session: Arc::new(OnceLock::new()),
        max_sessions,
    };
    let serving = CancellationToken::new();
    let stopping = serving.clone().drop_guard();
    let served = albireo_service::http::run(
        &options.http,
        http::routes(view.clone()),
        listener,
        serving.clone(),
    );
    let routing = async {
        let routed = route(config, options, &view, &shutdown).await;
        drop(stopping);
        routed
    };
    let (served, routed) = tokio::join!(
        async {
            let ended = served.await;
            // Without its interface a router cannot be watched: it ends.
            shutdown.cancel();
            ended
        },
        routing
    );
    routed.and(served.map_err(RouterError::from))
}

async fn route(
    config: Config,
    options: &RouterOptions,
    view: &RouterView,
    shutdown: &CancellationToken,
) -> Result<(), RouterError> {
    let of_router = config.clone();
    let opened = tokio::task::spawn_blocking(move || zenoh::open(config).wait()).await;
    let session = match opened {
        Ok(Ok(session)) => session,
        Ok(Err(error)) => return Err(RouterError::NotOpened(plain(&error))),
        Err(error) => return Err(RouterError::NotOpened(error.to_string())),
    };
    let endpoints: Vec<String> = session
        .info()
        .locators()
        .await
        .iter()
        .map(ToString::to_string)
        .collect();
    // It is opened once.
    let _ = view.session.set(session.clone());
    tracing::info!(
        zenoh = ?endpoints,
        sessions = view.max_sessions,
        access_control = !options.no_access_control,
        "ready"
    );
    let notified_view = view.clone();
    let notifier = tokio::spawn(notify::run(
        move || ServiceState {
            ready: notified_view.reason().is_none(),
            reasons: notified_view.reason().unwrap_or_default(),
            stuck: notified_view.probes.stuck(),
        },
        shutdown.clone(),
    ));
    let probing = endpoints.first().map(|endpoint| {
        tokio::spawn(view.probes.clone().run(
            of_router,
            endpoint.clone(),
            options.probe_every,
            shutdown.clone(),
        ))
    });
    shutdown.cancelled().await;
    let _ = notifier.await;
    let closing = tokio::task::spawn_blocking(move || session.close().wait());
    if !matches!(
        tokio::time::timeout(STOP_LIMIT, closing).await,
        Ok(Ok(Ok(())))
    ) {
        tracing::warn!("the router's session was not closed cleanly");
    }
    if let Some(probing) = probing {
        probing.abort();
    }
    Ok(())
}
