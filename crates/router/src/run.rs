//! The service: a Zenoh router with health, metrics and a count of whom it turns away, from start to stop.

use crate::http::{self, RouterView};
use crate::probe::Probes;
use crate::refusals::{Refusal, Refusals, Refused};
use albireo_service::config::HttpConfig;
use albireo_service::http::HttpError;
use albireo_service::notify::{self, Look};
use albireo_service::session::plain;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::{Config, Wait};

/// Time between two lines of the log on refusals of one kind.
const TOLD_EVERY: Duration = Duration::from_secs(10);

/// How long the session may take to close.
const STOP_LIMIT: Duration = Duration::from_secs(4);

/// What a router runs with.
#[derive(Clone, Debug)]
pub struct RouterOptions {
    /// Zenoh's configuration file: endpoints, certificates, limits.
    pub config: PathBuf,
    /// The section `access_control` that goes in it, as `albireo acl` writes it.
    pub access: Option<PathBuf>,
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
        Ok(config)
    }
}

/// Runs a router until `shutdown`; health and metrics are on `listener`. `refusals` and `refused` come from the layer of
/// the log that reads what Zenoh says ([`crate::refusals::layer`]).
///
/// # Errors
/// When a file cannot be used, an endpoint cannot be listened on, or the HTTP interface may not be offered.
pub async fn run(
    options: &RouterOptions,
    refusals: Refusals,
    refused: mpsc::Receiver<Refused>,
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
        refusals,
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
        let routed = route(config, options, &view, refused, &shutdown).await;
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
    refused: mpsc::Receiver<Refused>,
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
        access_control = options.access.is_some(),
        "ready"
    );
    let looked = view.clone();
    let telling = tokio::spawn(notify::run(
        move || Look {
            ready: looked.reason().is_none(),
            reasons: looked.reason().unwrap_or_default(),
            stuck: looked.probes.stuck(),
        },
        shutdown.clone(),
    ));
    let logging = tokio::spawn(log(refused));
    let probing = endpoints.first().map(|endpoint| {
        tokio::spawn(view.probes.clone().run(
            of_router,
            endpoint.clone(),
            options.probe_every,
            shutdown.clone(),
        ))
    });
    shutdown.cancelled().await;
    let _ = telling.await;
    let closing = tokio::task::spawn_blocking(move || session.close().wait());
    if !matches!(
        tokio::time::timeout(STOP_LIMIT, closing).await,
        Ok(Ok(Ok(())))
    ) {
        tracing::warn!("the router's session was not closed cleanly");
    }
    logging.abort();
    if let Some(probing) = probing {
        probing.abort();
    }
    Ok(())
}

/// Logs who was turned away: one line a kind and holder in ten seconds, with the number of those that were not told.
async fn log(mut refused: mpsc::Receiver<Refused>) {
    let mut told: HashMap<(Refusal, String), (Instant, u64)> = HashMap::new();
    while let Some(Refused { kind, who, what }) = refused.recv().await {
        let now = Instant::now();
        told.retain(|_, (at, held)| *held > 0 || now.duration_since(*at) < TOLD_EVERY);
        let (at, held) = told
            .entry((kind, who.clone()))
            .or_insert_with(|| (now.checked_sub(TOLD_EVERY).unwrap_or(now), 0));
        if now.duration_since(*at) < TOLD_EVERY {
            *held += 1;
            continue;
        }
        let held_back = std::mem::take(held);
        *at = now;
        tracing::warn!(kind = kind.as_str(), who, what, held_back, "turned away");
    }
}
