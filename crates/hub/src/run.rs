//! Runs a hub and its HTTP interface.

use crate::HubError;
use crate::answers::{Answers, Replies, SESSION, follow_router, send_notices};
use crate::config::{HubConfig, MAX_PAYLOAD_BYTES};
use crate::http;
use crate::hub::Hub;
use crate::ingest::{self, Recorder};
use crate::presence::follow_today;
use crate::store::{Store, StoreError};
use crate::tuning::{self, DesiredSettings, Notice, Tuner};
use albireo_service::clock::Now;
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
use tokio::task::{JoinHandle, spawn_blocking};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::query::Queryable;

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
    let address = listener.local_addr().map_err(HubError::at("the listener has no address"))?;
    for password in config.database.passwords() {
        logging::conceal(password);
    }
    let (desired, notices) = DesiredSettings::new();
    let hub = Hub::new(config, desired, shutdown.clone());
    hub.readiness.part("zenoh").not_ready("the session is not open yet");
    hub.readiness.part("database").not_ready("it is not open yet");
    // HTTP stops last, so that the state can be read until the end.
    let serving = CancellationToken::new();
    let http = albireo_service::http::run(
        &config.http,
        &config.tokens,
        &[Method::GET, Method::PUT, Method::POST, Method::DELETE],
        http::router(hub.clone()),
        listener,
        serving.clone(),
    );
    let manager = tokio::spawn(notify::run(service_state(hub.clone()), shutdown.clone()));
    tracing::info!(
        http = format!("http://{address}"),
        prefix = config.hub.prefix,
        "listening"
    );
    let http = async {
        let ended = http.await.map_err(HubError::at("[http]"));
        // Without its HTTP interface a hub cannot be monitored or controlled, so it stops.
        shutdown.cancel();
        ended
    };
    let work = async {
        let ended = parts(config, &hub, notices).await;
        serving.cancel();
        ended
    };
    let (http, work) = tokio::join!(http, work);
    // The service manager learns of the stop before the process exits, also after an error.
    let _ = manager.await;
    work.and(http)
}

/// Returns the hub's state for the service manager: not ready while the router or the database is absent, and stuck if
/// the writer does nothing while batches wait.
fn service_state(hub: Hub) -> impl Fn() -> (HealthStatus, Option<String>) {
    /// The last time when the writer was seen to work, or to have nothing to do.
    struct Progress {
        transactions: u64,
        at: Instant,
    }
    let last = Mutex::new(Progress {
        transactions: 0,
        at: Instant::now(),
    });
    move || {
        let status = hub.readiness.health().status();
        let all = hub.ingest.counts();
        let transactions = all.commits + all.database_errors;
        let mut last = last.lock();
        if hub.ingest.queued() == 0 || transactions != last.transactions {
            *last = Progress {
                transactions,
                at: Instant::now(),
            };
        }
        if last.at.elapsed() < STUCK_AFTER {
            return (status, None);
        }
        let why = "batches wait and the writer does nothing".to_owned();
        (status, Some(why))
    }
}

/// Starts the parts in order, waits for the shutdown, and stops them in reverse order.
async fn parts(config: &HubConfig, hub: &Hub, notices: Receiver<Notice>) -> Result<(), HubError> {
    let Some(tuner) = open_database(config, hub).await? else {
        return Ok(());
    };
    let store = tuner.store.clone();
    let Some(session) = open_session(config, hub).await? else {
        store.close().await;
        return Ok(());
    };
    let mut running = start(config, hub, &tuner, &session, notices).await?;
    let locators = session.info().locators().await;
    let addresses: Vec<_> = locators.iter().map(ToString::to_string).collect();
    tracing::info!(zenoh = addresses.join(" "), "ready");
    let watched = running.tasks.watch().await;

    // After a failure the other tasks have to stop.
    hub.shutdown.cancel();
    hub.readiness.part("zenoh").not_ready("the hub is stopping");
    let stop = running.stop(session, store);
    if tokio::time::timeout(STOP_LIMIT, stop).await.is_err() {
        tracing::warn!("stopping took too long; nodes keep the reports that were not committed");
    }
    watched.map_err(HubError::of)
}

/// Opens the database, and reads from it the nodes and what is desired. Tries again until it can be opened; `None` after a
/// shutdown.
async fn open_database(config: &HubConfig, hub: &Hub) -> Result<Option<Arc<Tuner>>, HubError> {
    let database = hub.readiness.part("database");
    let shown = config.database.shown();
    let tuner = loop {
        let error = match open(config, hub).await {
            Ok(opened) => break opened,
            Err(error) => error,
        };
        if !error.is_temporary() {
            return Err(HubError::of(format!("[database] {shown}: {error}")));
        }
        tracing::warn!(%error, database = shown, "trying again");
        database.not_ready(error.to_string());
        let pause = tokio::time::sleep(DATABASE_RETRY);
        if hub.shutdown.run_until_cancelled(pause).await.is_none() {
            return Ok(None);
        }
    };
    tracing::info!(database = tuner.store.kind(), "database opened");
    let _ = hub.tuner.set(Arc::clone(&tuner));
    // From now on the outcome of the transactions decides.
    let ingest = Arc::clone(&hub.ingest);
    hub.readiness.probe("database", "", move || {
        ingest.outcomes.fault(Instant::now())
    });
    let fleet = Arc::clone(&hub.fleet);
    hub.readiness.probe("fleet", "", move || fleet.fault());
    Ok(Some(tuner))
}

async fn open(config: &HubConfig, hub: &Hub) -> Result<Arc<Tuner>, StoreError> {
    let store = Store::open(&config.database).await?;
    hub.fleet.remember(store.nodes().await?, Instant::now());
    let tuner = Tuner::open(
        store,
        Arc::clone(&hub.fleet),
        Arc::clone(&hub.desired),
        config.tuning.clone(),
        Uuid::now_v7().to_string(),
    )
    .await?;
    Ok(Arc::new(tuner))
}

/// Opens the Zenoh session; `None` after a shutdown.
async fn open_session(config: &HubConfig, hub: &Hub) -> Result<Option<Session>, HubError> {
    let zenoh = hub.readiness.part("zenoh");
    let opening = session::open(&config.zenoh, MAX_PAYLOAD_BYTES, SESSION, true, |error| {
        zenoh.not_ready(error.to_string());
    });
    let session = hub
        .shutdown
        .run_until_cancelled(opening)
        .await
        .transpose()
        .map_err(HubError::of)?;
    if let Some(session) = &session {
        let _ = hub.session.set(session.clone());
    }
    Ok(session)
}

/// What a hub does while it runs.
struct Running {
    tasks: Supervisor,
    listening: Listening,
    /// Dropping it drops the inbox: the writer commits the waiting batches and ends.
    reports: Queryable<()>,
    /// Ends when the last answer is sent.
    replier: JoinHandle<()>,
}

/// What the session declared, but for the queryable of reports; dropping it undeclares all.
struct Listening {
    _statuses: Subscriber<()>,
    _tokens: Subscriber<()>,
    _pulls: Queryable<()>,
}

/// Starts everything between the session and the database, reports last: they are taken once all else works.
async fn start(
    config: &HubConfig,
    hub: &Hub,
    tuner: &Arc<Tuner>,
    session: &Session,
    notices: Receiver<Notice>,
) -> Result<Running, HubError> {
    let store = &tuner.store;
    // A hub that lost a task would look healthy and do half of its work. So the hub stops when a task ends, and the
    // service manager restarts it.
    let mut tasks = Supervisor::new(
        hub.readiness.clone(),
        TaskFailures::default(),
        hub.shutdown.clone(),
    );

    // Ingest: batches are parsed, and stored in one transaction with the nodes' states.
    let recorder =
        Recorder::new(store, &config.history, Now::system()).also_deletes(tuning::delete_old);
    let fleet = Arc::clone(&hub.fleet);
    let (inbox, written) = ingest::start(&config.ingest, recorder, fleet, Arc::clone(&hub.ingest));
    tasks.essential("writer", written);

    // Answers: statuses, tokens and pulls come from Zenoh, answers and notices go there.
    let keys = NodeKeys::all(&config.hub.prefix).map_err(HubError::at("[hub]"))?;
    let (replies, replier) = Replies::start(Arc::clone(&hub.ingest));
    let answers = Answers {
        fleet: Arc::clone(&hub.fleet),
        desired: Arc::clone(&hub.desired),
        counters: Arc::clone(&hub.ingest),
        replies,
    };
    let listening = Listening {
        _statuses: answers.hear_statuses(&keys, session).await?,
        _tokens: answers.hear_tokens(&keys, session).await?,
        _pulls: answers.answer_pulls(&keys, session).await?,
    };
    let notified = session.clone();
    let prefix = config.hub.prefix.clone();
    spawn_blocking(move || send_notices(&notified, &prefix, &notices));

    // Presence: nodes become silent, unless the hub itself is cut off.
    let router = match config.zenoh.mode {
        ZenohMode::Client => Some(session.clone()),
        ZenohMode::Router | ZenohMode::Peer => None,
    };
    let connection = hub.readiness.part_of("zenoh", "router");
    let sweeping = follow_router(Arc::clone(&hub.fleet), connection, router);
    tasks.until_shutdown("presence", sweeping);
    let today = follow_today(Arc::clone(&hub.fleet), store.clone());
    tasks.until_shutdown("today", today);

    // Tuning: settings are followed at the nodes, rollouts and trials go on.
    let part = hub.readiness.part("tuning");
    let following = tuning::follow(Arc::clone(tuner), part, hub.shutdown.clone());
    tasks.essential("tuning", following);
    tasks.until_shutdown("certificates", hub.certificates.clone().follow());
    // Logs each change of the health.
    let health = hub.readiness.clone().watch(Duration::from_secs(1));
    tasks.until_shutdown("readiness", health);

    let reports = answers.take_reports(&keys, session, inbox).await?;
    // Known nodes report their state now instead of at their next interval.
    hub.fleet.each(|node| hub.desired.notify(&node.node));
    hub.readiness.part("zenoh").works();
    Ok(Running {
        tasks,
        listening,
        reports,
        replier,
    })
}

impl Running {
    /// Stops in the reverse order: what was taken is stored and answered before the session closes.
    async fn stop(mut self, session: Session, store: Store) {
        drop(self.reports);
        self.tasks.finish().await;
        drop(self.listening);
        let _ = self.replier.await;
        if let Err(error) = session.close().await {
            tracing::warn!(%error, "Zenoh session not closed cleanly");
        }
        store.close().await;
    }
}
