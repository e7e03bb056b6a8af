//! The node's connection to the hub: sends reports and the status, receives the desired setting.
//!
//! Reports are queries that the hub answers after its commit; only such an answer acknowledges them. After no reply, an
//! error, a refusal or a timeout, the node keeps the reports and retries after a pause.

mod desired;
mod health;
mod query;
mod schedule;
mod status;
mod watched;

pub(super) use desired::{known, take};

use crate::backoff::Backoff;
use crate::outbox::{BatchScope, Outbox, OutboxConfig};
use crate::settings::Settings;
use crate::state::board::Board;
use crate::state::readiness;
use albireo_service::clock::Now;
use albireo_service::config::UplinkConfig;
use albireo_service::session;
use albireo_vision::picture::FrameLimits;
use albireo_wire::{
    BatchCompression, Desired, NodeKeys, ReportAnswer, ReportBatch, RevisionMessage, VERSION,
};
use futures_util::future::{BoxFuture, FutureExt, Shared};
use futures_util::stream::{FuturesUnordered, StreamExt};
use health::UplinkHealth;
use query::ask;
#[cfg(test)]
pub(super) use query::read_reply;
pub(super) use schedule::{Failure, HubPresence, Schedule};
pub(super) use status::StatusSender;
use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::spawn_blocking;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;
use tracing::Instrument;
use watched::Watched;
use zenoh::Session;
use zenoh::handlers::RingChannel;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Querier;

/// The interval at which the status is compared with the last sent one, and a hub is looked for.
const POLL_EVERY: Duration = Duration::from_secs(1);

/// The time without any answer to waiting reports after which the node reopens its uplink.
const STALE: Duration = Duration::from_secs(300);

/// The time limit for the last reports when the node stops. The outbox keeps those that do not arrive.
const LAST_TRY: Duration = Duration::from_millis(1500);

/// After a session of at least this length, the pauses between attempts start short again.
const MIN_UPTIME: Duration = Duration::from_secs(10);

/// Everything the uplink works with.
pub(crate) struct UplinkSetup {
    /// The state to report.
    pub board: Arc<Board>,
    /// The settings that the hub may change.
    pub settings: Arc<Settings>,
    /// The reports to deliver.
    pub outbox: Arc<Outbox>,
    /// How they are delivered.
    pub delivery: OutboxConfig,
    /// The session to the hub, and what the hub may see.
    pub uplink: UplinkConfig,
    /// Labels by which a hub selects nodes.
    pub labels: BTreeMap<String, String>,
    /// Limits of the pictures that the hub may see.
    pub limits: FrameLimits,
    /// The keys toward the hub.
    pub keys: NodeKeys,
    /// The local session, if it reaches the hub; otherwise a separate one is opened, and reopened when stale.
    pub local: Option<Session>,
}

impl UplinkSetup {
    /// The sign that the node is alive, on a session of its own.
    async fn alive_token(&self, session: &Session) -> zenoh::Result<Option<LivelinessToken>> {
        if self.local.is_some() || !self.uplink.liveliness {
            return Ok(None);
        }
        let token = session.liveliness().declare_token(self.keys.alive()).await?;
        Ok(Some(token))
    }
}

/// The running uplink.
pub(crate) struct Uplink {
    stop: CancellationToken,
    /// Ready once the task has ended.
    pub ended: Shared<BoxFuture<'static, ()>>,
}

impl Uplink {
    /// Starts the task.
    pub(crate) fn start(setup: UplinkSetup) -> Self {
        // The operating system provides random keys for each `RandomState`.
        let random = RandomState::new().hash_one("uplink");
        let run = (random >> 32) as u32;
        let stop = CancellationToken::new();
        let config = &setup.delivery;
        let labels = setup.labels.clone();
        let worker = Worker {
            status_sender: StatusSender::new(labels, run, Now::system()),
            watched: Watched::default(),
            schedule: Schedule::new(config, random, Instant::now()),
            reconnect: Backoff::new(config.retry_min_ms, config.retry_max_ms, random),
            health: UplinkHealth::new(
                setup.board.readiness.part(readiness::UPLINK),
                // Without an uplink of its own, a node need not have a hub.
                setup.local.is_none(),
            ),
            setup: Arc::new(setup),
            stop: stop.clone(),
        };
        let task = tokio::spawn(worker.run().instrument(tracing::info_span!("uplink")));
        let ended = task.map(drop).boxed().shared();
        Self { stop, ended }
    }

    /// Makes the task try to deliver once more, and waits until it has ended.
    pub(crate) async fn stop(self) {
        self.stop.cancel();
        self.ended.await;
    }
}

struct Worker {
    setup: Arc<UplinkSetup>,
    stop: CancellationToken,
    status_sender: StatusSender,
    watched: Watched,
    schedule: Schedule,
    /// The pauses after sessions that could not be opened or failed.
    reconnect: Backoff,
    health: UplinkHealth,
}

/// The outcome of a query, with the desired setting, if the answer has one.
type Outcome = Result<Option<Desired>, Failure>;

/// A query to the hub that has ended.
enum Ended {
    /// To store reports.
    Batch(Outcome),
    /// For the desired setting.
    Pull(Outcome),
}

impl Worker {
    async fn run(mut self) {
        loop {
            let session = match &self.setup.local {
                Some(session) => Ok(session.clone()),
                None => {
                    let opening = session::open_uplink(&self.setup.uplink);
                    let Some(opened) = self.stop.run_until_cancelled(opening).await else {
                        return;
                    };
                    opened
                }
            };
            let failed = match session {
                Ok(session) => match self.serve_and_close(session).await {
                    Some(failed) => failed,
                    None => return,
                },
                Err(error) => {
                    tracing::warn!("{error}");
                    error.to_string()
                }
            };
            match self.setup.board.certificates.invalid() {
                // A session that failed for a certificate does not come back by itself.
                Some(fault) => {
                    let why = format!("{failed}; {fault}");
                    self.health.no_session(&why, Duration::ZERO);
                }
                None => self.health.no_session(&failed, self.schedule.offline()),
            }
            let pause = sleep(self.reconnect.next());
            if self.stop.run_until_cancelled(pause).await.is_none() {
                return;
            }
        }
    }

    /// Serves the hub over a session, and closes it. Returns what failed; `None` if the node stops.
    async fn serve_and_close(&mut self, session: Session) -> Option<String> {
        let began = Instant::now();
        let served = self.serve(&session).await;
        if began.elapsed() > MIN_UPTIME {
            self.reconnect.reset();
        }
        if self.setup.local.is_none()
            && let Err(error) = session.close().await
        {
            tracing::debug!(%error, "uplink not closed cleanly");
        }
        let error = session::plain(&served.err()?);
        tracing::error!(error, "cannot communicate with the hub");
        Some(format!("cannot communicate with the hub: {error}"))
    }

    /// Serves the hub over `session` until the node stops.
    ///
    /// # Errors
    /// Zenoh's error, or that the session has had no answer for too long and must be opened again.
    async fn serve(&mut self, session: &Session) -> zenoh::Result<()> {
        let setup = Arc::clone(&self.setup);
        let keys = &setup.keys;
        let outbox = &setup.outbox;
        let timeout = Duration::from_millis(setup.delivery.answer_timeout_ms);
        let querier = |key: String| {
            session
                .declare_querier(key)
                .timeout(timeout)
                .congestion_control(CongestionControl::Block)
                .priority(Priority::DataLow)
        };
        let reports = querier(keys.report()).await?;
        let pulls = querier(keys.pull()).await?;
        let status = session
            .declare_publisher(keys.status())
            .congestion_control(CongestionControl::Drop)
            .priority(crate::publishing::COUNTERS)
            .await?;
        let news = session.declare_subscriber(keys.changed()).with(RingChannel::new(1)).await?;
        let is_own = setup.local.is_none();
        let _alive = setup.alive_token(session).await?;
        let mut last_try = None;
        let mut asked = FuturesUnordered::<BoxFuture<'_, Ended>>::new();
        self.watched.begin();
        self.schedule.begin(Instant::now());
        loop {
            let now = Instant::now();
            let counts = outbox.counts();
            let hub = HubPresence {
                is_connected: reports.matching_status().await?.matching(),
                watches: self.watched.is_on(now),
            };
            if let Some(scope) = self.schedule.next_batch(&counts, hub, now) {
                let sending = send_batch(&setup, &reports, scope);
                asked.push(sending.map(Ended::Batch).boxed());
            }
            let trouble = self.schedule.trouble(hub.is_connected, now);
            self.health.judge(trouble, hub.is_connected, keys);
            match last_try {
                None => {
                    let sender = &mut self.status_sender;
                    let clock = Now::system();
                    if let Some(payload) = sender.due(clock, &setup.board, &setup.settings, outbox)
                    {
                        status.put(payload).await?;
                    }
                    self.watched.serve(session, &setup).await?;
                    if pulls.matching_status().await?.matching() && self.schedule.next_pull(now) {
                        let pulling = pull(&setup, &pulls);
                        asked.push(pulling.map(Ended::Pull).boxed());
                    }
                }
                Some(until) => {
                    if !self.schedule.is_sending() || now >= until {
                        return Ok(());
                    }
                }
            }
            if is_own && hub.is_connected && self.schedule.is_stale(STALE, now) {
                return Err("no answer to the waiting reports for too long".into());
            }
            let latest = last_try.unwrap_or(now + POLL_EVERY);
            let due = self.schedule.next_due(latest, now);
            tokio::select! {
                () = self.stop.cancelled(), if last_try.is_none() => {
                    let now = Instant::now();
                    last_try = Some(now + LAST_TRY);
                    self.schedule.send_now(now);
                }
                Some(ended) = asked.next() => self.take(ended).await,
                () = outbox.changed() => {}
                Ok(_) = news.recv_async() => self.schedule.want_pull(),
                () = tokio::time::sleep_until(due.into()) => {}
            }
        }
    }

    async fn take(&mut self, ended: Ended) {
        let now = Instant::now();
        let outcome = match ended {
            Ended::Batch(outcome) => {
                self.schedule.batch_ended(&outcome, now);
                outcome
            }
            Ended::Pull(outcome) => {
                self.schedule.pull_ended(&outcome, now);
                outcome
            }
        };
        let Ok(Some(desired)) = outcome else { return };
        self.status_sender.follow(&desired);
        if let Some(seconds) = desired.watched_for_s {
            self.watched.extend(seconds);
        }
        // On a blocking thread, because it writes a file.
        let setup = Arc::clone(&self.setup);
        let taken = spawn_blocking(move || take(&desired, &setup.settings, &setup.board));
        if taken.await.unwrap_or(false) {
            self.status_sender.full_is_due();
        }
    }
}

/// Sends the oldest reports, and applies the answer to the outbox.
async fn send_batch(setup: &Arc<UplinkSetup>, reports: &Querier<'_>, scope: BatchScope) -> Outcome {
    let sending = Arc::clone(setup);
    let prepared = spawn_blocking(move || {
        let node = &sending.board.node;
        let now = Now::system();
        let batch = sending.outbox.change(|waiting| waiting.batch(node, scope, now))?;
        let payload = batch.to_payload(BatchCompression::Best);
        Some((batch, payload))
    });
    let (batch, payload) = match prepared.await {
        Ok(Some((batch, Ok(payload)))) => (batch, payload),
        Ok(None) => return Ok(None),
        Ok(Some((_, Err(error)))) => {
            tracing::error!(%error, "clip reports cannot be written");
            return Err(Failure::Unanswered);
        }
        Err(error) => {
            tracing::error!(%error, "clip reports cannot be written");
            return Err(Failure::Unanswered);
        }
    };
    let reply = ask::<ReportAnswer>(reports, payload).await;
    let outbox = Arc::clone(&setup.outbox);
    spawn_blocking(move || conclude(&outbox, &batch, reply, Now::system()))
        .await
        .unwrap_or(Err(Failure::Unanswered))
}

/// Applies the outcome of `batch` to the outbox and returns the desired setting, if the answer has one. Writes a file.
pub(crate) fn conclude(
    outbox: &Outbox,
    batch: &ReportBatch,
    reply: Result<ReportAnswer, Failure>,
    now: Now,
) -> Outcome {
    let answer = reply?;
    let stored = outbox.change(|waiting| waiting.answered(batch, &answer, now));
    tracing::debug!(stored, "clip reports acknowledged");
    Ok(answer.desired)
}

/// Queries the desired setting.
async fn pull(setup: &UplinkSetup, pulls: &Querier<'_>) -> Outcome {
    let request = RevisionMessage {
        v: VERSION,
        revision: known(&setup.settings).revision(),
    };
    let payload = serde_json::to_vec(&request).unwrap_or_default();
    ask::<Desired>(pulls, payload).await.map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PreparedNode;
    use crate::config::NodeConfig;
    use albireo_wire::{ClipReport, HealthState, RefusalReason, ReportRefusal};
    use std::sync::atomic::{AtomicBool, Ordering};
    use zenoh::Wait;

    fn setup(node: &PreparedNode, config: NodeConfig, local: Option<Session>) -> UplinkSetup {
        UplinkSetup {
            board: Arc::clone(&node.board),
            settings: Arc::clone(&node.settings),
            outbox: Arc::clone(&node.outbox),
            keys: config.keys().unwrap(),
            delivery: config.outbox,
            uplink: config.uplink,
            labels: config.node.labels,
            limits: config.frame,
            local,
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_node_says_that_no_hub_acknowledges_its_reports_and_stays_ready() {
        let on_a_free_port = ("listen/endpoints", r#"["tcp/127.0.0.1:0"]"#);
        let router = crate::api::name::tests::session(&[on_a_free_port]).await;
        let locators = router.info().locators().await;
        let mut config = NodeConfig::default();
        config.outbox.patience_ms = 100;
        config.uplink.connect = vec![locators[0].to_string()];
        let node = PreparedNode::new(&config).unwrap();
        let mut health = node.board.readiness.subscribe();
        let uplink = Uplink::start(setup(&node, config, None));
        node.outbox
            .change(|waiting| waiting.insert(&mut [ClipReport::default()], Now::system()));
        let mut said = async |wanted: &str| {
            let fault = health.wait_for(|health| {
                let reason = health.reasons.get(readiness::UPLINK);
                reason.map_or("", String::as_str).contains(wanted)
            });
            let found = tokio::time::timeout(Duration::from_secs(60), fault).await;
            assert!(found.is_ok_and(|seen| seen.is_ok()), "not said: {wanted}");
        };
        said("no hub answers on `albireo/@report/node`").await;
        let faults = node.board.readiness.health().faults;
        let uplink_fault = faults.iter().find(|fault| fault.part == readiness::UPLINK);
        assert_eq!(uplink_fault.unwrap().fault.effect, HealthState::Degraded);
        // A hub refuses the reports, and takes them later.
        let refusal = ReportRefusal {
            v: VERSION,
            reason: RefusalReason::Unavailable,
            detail: "the disk is full".to_owned(),
            retry_after_ms: None,
        };
        let refusal_bytes = serde_json::to_vec(&refusal).unwrap();
        let accepts = Arc::new(AtomicBool::new(false));
        let accepting = Arc::clone(&accepts);
        let hub = router.declare_queryable("albireo/@report/node").callback(move |query| {
            let answer = serde_json::to_vec(&ReportAnswer::default()).unwrap();
            let _ = if accepting.load(Ordering::Relaxed) {
                query.reply(query.key_expr().clone(), answer).wait()
            } else {
                query.reply_err(refusal_bytes.clone()).wait()
            };
        });
        let _hub = hub.await.unwrap();
        said("the hub refuses clip reports: unavailable: the disk is full").await;
        accepts.store(true, Ordering::Relaxed);
        let works = health.wait_for(|health| !health.reasons.contains_key(readiness::UPLINK));
        let found = tokio::time::timeout(Duration::from_secs(60), works).await;
        assert!(found.unwrap().is_ok());
        assert_eq!(node.outbox.counts().status.waiting, 0);
        uplink.stop().await;
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_router_that_is_not_reached_is_named_with_the_cause() {
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", free.local_addr().unwrap());
        drop(free);
        let mut config = NodeConfig::default();
        config.outbox.offline_h = 0.0;
        config.uplink.connect = vec![endpoint.clone()];
        let node = PreparedNode::new(&config).unwrap();
        let mut health = node.board.readiness.subscribe();
        let uplink = Uplink::start(setup(&node, config, None));
        let expected = format!("{endpoint}: refuses the connection: nothing listens there");
        let fault = health.wait_for(|health| {
            let reason = health.reasons.get(readiness::UPLINK);
            reason.is_some_and(|reason| reason.contains(&expected))
        });
        let found = tokio::time::timeout(Duration::from_secs(60), fault).await;
        assert!(found.unwrap().is_ok());
        uplink.stop().await;
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_mute_session_is_a_fault_of_the_uplink() {
        let mut config = NodeConfig::default();
        config.outbox.retry_min_ms = 1;
        let node = PreparedNode::new(&config).unwrap();
        let closed = crate::api::name::tests::session_alone().await;
        closed.close().await.unwrap();
        let mut health = node.board.readiness.subscribe();
        let uplink = Uplink::start(setup(&node, config, Some(closed)));
        let fault = health.wait_for(|health| health.reasons.contains_key(readiness::UPLINK));
        let found = tokio::time::timeout(Duration::from_secs(60), fault).await;
        assert!(found.unwrap().is_ok());
        uplink.stop().await;
    }
}
