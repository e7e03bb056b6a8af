//! Runs a hub and its HTTP interface.

use crate::config::{HubConfig, MAX_PAYLOAD_BYTES};
use crate::error::HubError;
use crate::http::{self, HubView, Reach};
use crate::ingest::{self, Replies};
use crate::presence::{NodeView, listen};
use crate::store::{Store, StoreError};
use crate::tuning::{self, Tuner};
use albireo_service::notify::{self, ServiceState};
use albireo_service::readiness::Readiness;
use albireo_service::supervise::{Supervisor, TaskFailures};
use albireo_service::{logging, session};
use axum::http::Method;
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

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
    let address = listener
        .local_addr()
        .map_err(HubError::at("the listener has no address"))?;
    config.database.passwords().for_each(logging::conceal);
    let readiness = Readiness::default();
    (readiness.part("zenoh")).not_ready("the session is not open yet");
    (readiness.part("database")).not_ready("it is not open yet");
    let view = HubView::new(config, readiness, shutdown.clone());
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
    let stopping = shutdown.child_token();
    let notifier = tokio::spawn(notify::run(service_state(view.clone()), stopping.clone()));
    tracing::info!(
        http = format!("http://{address}"),
        prefix = config.hub.prefix,
        "listening"
    );
    let hub = async {
        let ended = parts(config, &view).await;
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
    stopping.cancel();
    let _ = notifier.await;
    hub.and(http)
}

/// Returns the hub's state for the service manager: not ready while the router or the database is absent, and stuck if
/// the writer does nothing while batches wait.
fn service_state(view: HubView) -> impl Fn() -> ServiceState {
    let moved = Mutex::new((0, Instant::now()));
    move || {
        let health = view.readiness.health();
        let all = view.ingest.counts();
        let tried = all.commits + all.database_errors + all.refused_unavailable + all.batches;
        let mut moved = moved.lock();
        if view.ingest.queued() == 0 || tried != moved.0 {
            *moved = (tried, Instant::now());
        }
        let stuck = moved.1.elapsed() >= STUCK_AFTER;
        ServiceState {
            ready: health.is_ready(),
            reasons: health.status().text(),
            stuck: stuck.then(|| "batches wait and the writer does nothing".to_owned()),
        }
    }
}

/// Starts the parts in order, waits for the shutdown, and stops them in reverse order.
async fn parts(config: &HubConfig, view: &HubView) -> Result<(), HubError> {
    let (readiness, shutdown) = (&view.readiness, &view.shutdown);
    let (database, zenoh) = (readiness.part("database"), readiness.part("zenoh"));
    // The database may become unreachable again at any moment.
    let opening = || async {
        let store = Store::open(&config.database).await?;
        let nodes = view.fleet.read(&store, Instant::now()).await?;
        Ok((store, nodes))
    };
    let opened = patiently(config, view, opening).await?;
    let Some((store, nodes)) = opened else {
        return Ok(());
    };
    tracing::info!(database = store.kind(), nodes, "database opened");
    // This is the only place that sets it.
    let _ = view.opened.set(store.clone());
    database.works();
    let opening = session::open(&config.zenoh, MAX_PAYLOAD_BYTES, SESSION, true, |error| {
        zenoh.not_ready(error.to_string());
    });
    let opened = shutdown.run_until_cancelled(opening).await.transpose();
    let Some(session) = opened.map_err(|error| HubError(error.to_string()))? else {
        store.close().await;
        return Ok(());
    };

    let (replies, replier) = Replies::start(Arc::clone(&view.ingest));
    let (queue, written) = ingest::start(config, view, &store, &replies);
    // A hub that lost a task would look healthy and do half of its work. So the hub stops when a task ends, and the
    // service manager restarts it.
    let mut tasks = Supervisor::new(readiness.clone(), TaskFailures::default(), shutdown.clone());
    tasks.essential("writer", written);
    let (listening, receiving) = listen(config, view, &session, replies).await?;
    tasks.essential("presence", receiving);
    let (fleet, history) = (Arc::clone(&view.fleet), store.clone());
    tasks.until_shutdown("today", async move {
        fleet.follow_today(&history).await;
    });
    let _ = view.reaches.set(Reach {
        session: session.clone(),
        notifier: listening.notifier.clone(),
    });
    let reports = session
        .declare_queryable(config.keys()?.report())
        .complete(true)
        .callback(move |query| queue.take(query))
        .await
        .map_err(HubError::at("reports cannot be received"))?;
    // `None` means that the hub is stopping; batches that were accepted until then are committed below.
    let opening = || {
        Tuner::open(
            store.clone(),
            view.fleet.clone(),
            Arc::clone(&view.desires),
            listening.notifier.clone(),
            config.tuning.clone(),
            session.zid().to_string(),
        )
    };
    let tuner = patiently(config, view, opening).await?;
    database.works();
    if let Some(tuner) = tuner.map(Arc::new) {
        let _ = view.tunes.set(Arc::clone(&tuner));
        tasks.essential("tuning", tuning::follow(tuner, shutdown.clone()));
    }
    // Known nodes report their state now instead of at their next interval.
    view.fleet.each(|NodeView { node, .. }| {
        let notice = (node.clone(), view.desires.of(node).revision);
        let _ = listening.notifier.try_send(notice);
    });
    zenoh.works();
    let locators: Vec<String> = session
        .info()
        .locators()
        .await
        .iter()
        .map(ToString::to_string)
        .collect();
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

/// Retries `open` until the database answers. Returns `None` if the hub stops first.
async fn patiently<T, F: Future<Output = Result<T, StoreError>>>(
    config: &HubConfig,
    view: &HubView,
    open: impl Fn() -> F,
) -> Result<Option<T>, HubError> {
    loop {
        let error = match open().await {
            Ok(opened) => return Ok(Some(opened)),
            Err(error) => error,
        };
        if !error.passes() {
            let what = format!("[database] {}", config.database.shown());
            return Err(HubError::at(&what)(error));
        }
        tracing::warn!(%error, database = config.database.shown(), "trying again");
        (view.readiness.part("database")).not_ready(error.to_string());
        tokio::select! {
            () = tokio::time::sleep(DATABASE_RETRY) => {}
            () = view.shutdown.cancelled() => return Ok(None),
        }
    }
}
