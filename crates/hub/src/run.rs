//! Runs a hub and its HTTP interface.

use crate::HubError;
use crate::config::{HubConfig, MAX_PAYLOAD_BYTES};
use crate::desired::Desires;
use crate::http::{self, HubView};
use crate::ingest::{self, Replies};
use crate::presence::{NodeView, follow_today, listen, send_notices, watch};
use crate::store::{Store, StoreError};
use crate::tuning::{self, Tuner};
use albireo_service::config::ZenohMode;
use albireo_service::notify;
use albireo_service::supervise::{Supervisor, TaskFailures};
use albireo_service::{logging, session};
use albireo_wire::{HealthStatus, NodeKeys};
use axum::http::Method;
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::task::spawn_blocking;
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

/// The Zenoh settings of a hub, in addition to the configured ones. The lease is long because many joining nodes can
/// keep a router busy for 30 s: a session that is lost then declares everything again, which keeps the router busy for
/// longer. The limits leave room for nodes that connect to the hub itself: by default Zenoh silently refuses sessions
/// beyond 1,000.
const SESSION: &[(&str, &str)] = &[
    ("transport/link/tx/lease", "60000"),
    ("transport/unicast/max_sessions", "12000"),
    ("transport/unicast/accept_pending", "2000"),
    // There are few hubs, so they may reconnect immediately.
    (
        "connect/retry",
        r#"{"period_init_ms":250,"period_max_ms":2000,"period_increase_factor":2}"#,
    ),
];

/// The `max_sessions` of [`SESSION`], for the metrics.
pub(crate) const MAX_SESSIONS: u64 = 12_000;

/// The writer counts as stuck if, for this long, batches wait while none is answered and no transaction is tried.
const STUCK_AFTER: Duration = Duration::from_secs(120);

/// Time limit for stopping.
const STOP_LIMIT: Duration = Duration::from_millis(4500);
/// Pause before the database is tried again.
const DATABASE_RETRY: Duration = Duration::from_secs(1);

/// Runs a hub and its HTTP interface on `listener` until `shutdown`.
///
/// HTTP starts first, so that a health check works while the database or the router is absent.
///
/// # Errors
/// When the configuration is invalid, or the HTTP interface must not be served as configured.
pub async fn run(
    config: &HubConfig,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), HubError> {
    let address = listener.local_addr();
    let address = address.map_err(HubError::at("the listener has no address"))?;
    config.database.passwords().for_each(logging::conceal);
    let (desires, notices) = Desires::new();
    let view = HubView::new(config, desires, shutdown.clone());
    view.readiness.part("zenoh").not_ready("the session is not open yet");
    view.readiness.part("database").not_ready("it is not open yet");
    // HTTP stops last, so that the state can be read until the end.
    let serving = CancellationToken::new();
    let http = albireo_service::http::run(
        &config.http,
        &config.tokens,
        &[Method::GET, Method::PUT, Method::POST, Method::DELETE],
        http::router(view.clone()),
        listener,
        serving.clone(),
    );
    let manager = tokio::spawn(notify::run(service_state(view.clone()), shutdown.clone()));
    tracing::info!(
        http = format!("http://{address}"),
        prefix = config.hub.prefix,
        "listening"
    );
    let hub = async {
        let ended = parts(config, &view, notices).await;
        serving.cancel();
        ended
    };
    let (http, hub) = tokio::join!(
        async {
            let ended = http.await.map_err(HubError::at("[http]"));
            // Without its HTTP interface a hub cannot be monitored or controlled, so it stops.
            shutdown.cancel();
            ended
        },
        hub
    );
    // The service manager learns of the stop before the process exits, also after an error.
    let _ = manager.await;
    hub.and(http)
}

/// Returns the hub's state for the service manager: not ready while the router or the database is absent, and stuck if
/// the writer does nothing while batches wait.
fn service_state(view: HubView) -> impl Fn() -> (HealthStatus, Option<String>) {
    let moved = Mutex::new((0, Instant::now()));
    move || {
        let health = view.readiness.health();
        let all = view.ingest.counts();
        let tried = all.commits + all.database_errors;
        let mut moved = moved.lock();
        if view.ingest.queued() == 0 || tried != moved.0 {
            *moved = (tried, Instant::now());
        }
        let stuck = moved.1.elapsed() >= STUCK_AFTER;
        let stuck = stuck.then(|| "batches wait and the writer does nothing".to_owned());
        (health.status(), stuck)
    }
}

/// Starts the parts in order, waits for the shutdown, and stops them in reverse order.
async fn parts(
    config: &HubConfig,
    view: &HubView,
    notices: Receiver<(String, u64)>,
) -> Result<(), HubError> {
    let readiness = &view.readiness;
    let shutdown = &view.shutdown;
    let database = readiness.part("database");
    let zenoh = readiness.part("zenoh");
    let tuner = loop {
        let error = match open(config, view).await {
            Ok(opened) => break opened,
            Err(error) => error,
        };
        let shown = config.database.shown();
        if !error.passes() {
            return Err(HubError::at(&format!("[database] {shown}"))(error));
        }
        tracing::warn!(%error, database = shown, "trying again");
        database.not_ready(error.to_string());
        let pause = tokio::time::sleep(DATABASE_RETRY);
        if shutdown.run_until_cancelled(pause).await.is_none() {
            return Ok(());
        }
    };
    let store = tuner.store.clone();
    tracing::info!(database = store.kind(), "database opened");
    let _ = view.opened.set(Arc::clone(&tuner));
    let ingest = Arc::clone(&view.ingest);
    // From now on the outcome of the transactions decides.
    readiness.probe("database", "", move || {
        ingest.outcomes.fault(Instant::now())
    });
    let fleet = Arc::clone(&view.fleet);
    readiness.probe("fleet", "", move || fleet.fault());
    let opening = session::open(&config.zenoh, MAX_PAYLOAD_BYTES, SESSION, true, |error| {
        zenoh.not_ready(error.to_string());
    });
    let opened = shutdown.run_until_cancelled(opening).await.transpose();
    let Some(session) = opened.map_err(|error| HubError(error.to_string()))? else {
        store.close().await;
        return Ok(());
    };
    let _ = view.session.set(session.clone());
    let notified = session.clone();
    let prefix = config.hub.prefix.clone();
    spawn_blocking(move || send_notices(&notified, &prefix, &notices));

    let (replies, replier) = Replies::start(Arc::clone(&view.ingest));
    let (take, written) = ingest::start(config, view, &store, &replies);
    // A hub that lost a task would look healthy and do half of its work. So the hub stops when a task ends, and the
    // service manager restarts it.
    let mut tasks = Supervisor::new(readiness.clone(), TaskFailures::default(), shutdown.clone());
    tasks.essential("writer", written);
    let keys = NodeKeys::all(&config.hub.prefix).map_err(HubError::at("[hub]"))?;
    let listening = listen(&keys, view, &session, replies).await?;
    let router = (config.zenoh.mode == ZenohMode::Client).then(|| session.clone());
    tasks.until_shutdown("presence", watch(view.clone(), router));
    // Logs each change of the health.
    tasks.until_shutdown("readiness", readiness.clone().watch(Duration::from_secs(1)));
    let today = follow_today(Arc::clone(&view.fleet), store.clone());
    tasks.until_shutdown("today", today);
    let reports = session.declare_queryable(keys.report()).complete(true).callback(take).await;
    let reports = reports.map_err(HubError::at("reports cannot be received"))?;
    tasks.essential(
        "tuning",
        tuning::follow(tuner, readiness.part("tuning"), shutdown.clone()),
    );
    // Known nodes report their state now instead of at their next interval.
    view.fleet.each(|NodeView { node, .. }| view.desires.notify(node));
    zenoh.works();
    let locators = session.info().locators().await;
    tracing::info!(zenoh = ?locators, "ready");

    let watched = tasks.watch().await;
    // After a failure the other tasks have to stop.
    shutdown.cancel();
    zenoh.not_ready("the hub is stopping");
    // This drops the queue's only sender: the writer commits the waiting batches and ends.
    drop(reports);
    let stop = async {
        tasks.finish().await;
        drop(listening);
        // The last answers are sent before the session closes.
        let _ = replier.await;
        if let Err(error) = session.close().await {
            tracing::warn!(%error, "Zenoh session not closed cleanly");
        }
        store.close().await;
    };
    if tokio::time::timeout(STOP_LIMIT, stop).await.is_err() {
        tracing::warn!("stopping took too long; nodes keep the reports that were not committed");
    }
    watched.map_err(|error| HubError(error.to_string()))
}

/// Opens the database, and reads from it the nodes and what was ordered.
async fn open(config: &HubConfig, view: &HubView) -> Result<Arc<Tuner>, StoreError> {
    let store = Store::open(&config.database).await?;
    view.fleet.remember(store.nodes().await?, Instant::now());
    let tuner = Tuner::open(
        store,
        Arc::clone(&view.fleet),
        Arc::clone(&view.desires),
        config.tuning.clone(),
        Uuid::now_v7().to_string(),
    );
    Ok(Arc::new(tuner.await?))
}
