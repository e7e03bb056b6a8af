//! The service: a hub and its HTTP interface, from start to stop.

use crate::config::{HubConfig, MAX_PAYLOAD_BYTES};
use crate::http::{self, HubView};
use crate::readiness::Readiness;
use albireo_service::session;
use anyhow::Context;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use zenoh::Session;

/// What a hub's session needs beyond what is configured. A long lease, because a storm of joining nodes can keep a
/// router busy for half a minute, and a session that is lost then declares everything anew and makes it longer. Room
/// for nodes that connect to the hub itself: the default refuses the thousand-and-first without a word.
const SESSION: session::Settings<'static> = &[
    ("transport/link/tx/lease", "60000"),
    ("transport/unicast/max_sessions", "12000"),
    ("transport/unicast/accept_pending", "2000"),
];

/// Runs a hub and its HTTP interface on `listener` until `shutdown`.
///
/// HTTP answers first, so that a health check sees a hub whose database or router is not there yet.
///
/// # Errors
/// When the configuration cannot be used, or the HTTP interface may not be offered as configured.
pub async fn run(
    config: &HubConfig,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> anyhow::Result<()> {
    let address = listener
        .local_addr()
        .context("the listener has no address")?;
    let readiness = Arc::new(Readiness::default());
    readiness.hold("zenoh", "the session is not open yet");
    let view = HubView {
        readiness: Arc::clone(&readiness),
    };
    // HTTP outlives the rest, so that a look is possible until the end.
    let serving = CancellationToken::new();
    let http = albireo_service::http::run_with_tokens(
        &config.http,
        &config.tokens,
        http::router(view),
        listener,
        serving.clone(),
    );
    tracing::info!(
        http = format!("http://{address}"),
        prefix = config.hub.prefix,
        "listening"
    );
    let hub = async {
        let ended = parts(config, &readiness, &shutdown).await;
        serving.cancel();
        ended
    };
    let (http, hub) = tokio::join!(
        async {
            let ended = http.await.context("[http]");
            // Without its interface a hub cannot be watched or stopped: it ends.
            shutdown.cancel();
            ended
        },
        hub
    );
    hub.and(http)
}

/// Starts the parts in order, waits for the shutdown, and stops them in the opposite one.
async fn parts(
    config: &HubConfig,
    readiness: &Arc<Readiness>,
    shutdown: &CancellationToken,
) -> anyhow::Result<()> {
    let Some(session) = open(config, readiness, shutdown).await? else {
        return Ok(());
    };
    readiness.release("zenoh");
    let zenoh: Vec<String> = session
        .info()
        .locators()
        .await
        .iter()
        .map(ToString::to_string)
        .collect();
    tracing::info!(?zenoh, "ready");
    shutdown.cancelled().await;
    if let Err(error) = session.close().await {
        tracing::warn!(%error, "Zenoh session not closed cleanly");
    }
    Ok(())
}

async fn open(
    config: &HubConfig,
    readiness: &Arc<Readiness>,
    shutdown: &CancellationToken,
) -> anyhow::Result<Option<Session>> {
    let session = session::open_patiently(
        &config.zenoh,
        MAX_PAYLOAD_BYTES,
        SESSION,
        shutdown,
        |error| {
            tracing::warn!(%error, "trying again");
            readiness.hold("zenoh", &error.to_string());
        },
    )
    .await?;
    Ok(session)
}
