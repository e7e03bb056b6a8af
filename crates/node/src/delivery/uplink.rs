//! The node's side of the hub: reports as queries that are answered after the hub's commit, status, and what the hub
//! desires. One thread, for each of these may wait.
//!
//! Only an answer acknowledges. No reply, an error, a refusal and a time-out all mean: keep, and try again after a
//! pause that doubles, with jitter.

mod backoff;
mod delivery;
mod desired;
mod gathering;
mod query;
mod status;
mod watched;

pub(crate) use desired::DesiredKeeper;

use crate::delivery::outbox::{Outbox, OutboxConfig};
use crate::state::board::Board;
use crate::state::readiness;
use albireo_service::config::UplinkConfig;
use albireo_service::session;
use albireo_vision::picture::FrameLimits;
use albireo_wire::{Desired, FleetKeys, PullRequest, VERSION};
use backoff::Backoff;
use delivery::Delivery;
use gathering::Gathering;
use query::{Asked, Patience, ask};
use status::StatusTeller;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use watched::Watched;
use zenoh::Session;
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Querier;

/// How often the status is looked at for changes.
const LOOK: Duration = Duration::from_secs(1);

/// How long the last reports may take to reach a hub when the node stops: what is not there then is kept.
const LAST_TRY: Duration = Duration::from_millis(1500);

/// A session that served for so long ended for another reason than the one before.
const LASTED: Duration = Duration::from_secs(10);

/// What the uplink works with.
pub(crate) struct UplinkSetup {
    /// What is told.
    pub board: Arc<Board>,
    /// What is delivered.
    pub outbox: Outbox,
    /// The manners.
    pub config: OutboxConfig,
    /// Keys toward the hub.
    pub keys: FleetKeys,
    /// Labels of the node.
    pub labels: BTreeMap<String, String>,
    /// What the hub desires, and what is in force.
    pub desired: DesiredKeeper,
    /// Limits for decoding pictures that are asked for.
    pub limits: FrameLimits,
    /// Where the hub is found.
    pub way: Way,
}

/// The way to the hub.
pub(crate) enum Way {
    /// The local session serves both.
    Local(Session),
    /// A session of its own, opened anew when it has gone stale.
    Own(UplinkConfig),
}

/// The uplink's thread. Ends when told.
pub(crate) struct Uplink {
    stop: Arc<AtomicBool>,
    outbox: Outbox,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Uplink {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system has no thread left.
    pub(crate) fn start(setup: UplinkSetup) -> std::io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let outbox = setup.outbox.clone();
        let node = setup.board.node().to_owned();
        let mut worker = Worker {
            teller: StatusTeller::new(setup.labels.clone()),
            watched: Watched::new(setup.limits),
            gathering: Gathering::new(&setup.config),
            delivery: Delivery::new(outbox.clone(), node, &setup.config),
            reconnect: Backoff::new(setup.config.retry_min_ms, setup.config.retry_max_ms),
            setup,
            stop: Arc::clone(&stop),
            notified: Arc::new(AtomicU64::new(0)),
            pull_due: true,
            last_answer: Instant::now(),
        };
        let thread = std::thread::Builder::new()
            .name("uplink".to_owned())
            .spawn(move || worker.run())?;
        Ok(Self {
            stop,
            outbox,
            thread: Some(thread),
        })
    }

    /// Tells the thread to try once more and end; blocks until it has.
    pub(crate) fn stop(mut self) {
        self.tell();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the uplink failed");
        }
    }

    fn tell(&self) {
        self.stop.store(true, Ordering::Release);
        self.outbox.wake();
    }
}

impl Drop for Uplink {
    fn drop(&mut self) {
        self.tell();
    }
}

struct Worker {
    setup: UplinkSetup,
    teller: StatusTeller,
    delivery: Delivery,
    /// Pauses between sessions that could not be opened or failed.
    reconnect: Backoff,
    stop: Arc<AtomicBool>,
    /// Highest revision that was notified.
    notified: Arc<AtomicU64>,
    pull_due: bool,
    last_answer: Instant,
    watched: Watched,
    /// The hub that answered in this session reads heartbeats.
    gathering: Gathering,
}

enum Served {
    Stopped,
    Stale,
    Failed(zenoh::Error),
}

impl Worker {
    fn run(&mut self) {
        let part = self.setup.board.readiness().part(readiness::UPLINK);
        loop {
            self.look_after_disk();
            let session = match &self.setup.way {
                Way::Local(session) => session.clone(),
                Way::Own(uplink) => match session::open_uplink(uplink) {
                    Ok(session) => session,
                    Err(error) => {
                        tracing::warn!("{error:#}");
                        part.degraded("the hub's router cannot be reached");
                        if self.pause() {
                            return;
                        }
                        continue;
                    }
                },
            };
            part.works();
            let began = Instant::now();
            self.last_answer = began;
            let served = self.serve(&session);
            if began.elapsed() > LASTED {
                self.reconnect.reset();
            }
            let own = matches!(self.setup.way, Way::Own(..));
            if own && let Err(error) = session.close().wait() {
                tracing::debug!(%error, "uplink not closed cleanly");
            }
            match served {
                Served::Stopped => return,
                Served::Stale => {
                    tracing::warn!("the uplink brought no answer for long: opened anew")
                }
                Served::Failed(error) => {
                    tracing::error!(
                        error = session::plain(&error),
                        "the hub cannot be spoken to"
                    );
                    if self.pause() {
                        return;
                    }
                }
            }
        }
    }

    /// Waits a while with jitter; whether to stop.
    fn pause(&mut self) -> bool {
        let until = Instant::now() + self.reconnect.next(None);
        let mut revision = 0;
        while Instant::now() < until {
            if self.stop.load(Ordering::Acquire) {
                return true;
            }
            self.look_after_disk();
            let look = until.min(Instant::now() + LOOK);
            revision = self.setup.outbox.wait_for_change(revision, look);
        }
        self.stop.load(Ordering::Acquire)
    }

    /// Tries a disk that failed again, and compares settings that can be read only now.
    fn look_after_disk(&self) {
        let setup = &self.setup;
        setup.outbox.look_after_disk();
        if setup.outbox.settings_returned() {
            setup.desired.read_again(&setup.board, &setup.outbox);
        }
    }

    fn serve(&mut self, session: &Session) -> Served {
        match self.serve_until(session) {
            Ok(served) => served,
            Err(error) => Served::Failed(error),
        }
    }

    fn serve_until(&mut self, session: &Session) -> zenoh::Result<Served> {
        let keys = self.setup.keys.clone();
        let timeout = Duration::from_millis(self.setup.config.answer_timeout_ms);
        let querier = |key: String| -> zenoh::Result<Querier<'static>> {
            session
                .declare_querier(key)
                .timeout(timeout)
                .congestion_control(CongestionControl::Block)
                .priority(Priority::DataLow)
                .wait()
        };
        let reports = querier(keys.report())?;
        let pulls = querier(keys.pull())?;
        let notifier = self.setup.outbox.clone();
        let _listener = reports
            .matching_listener()
            .callback(move |_| notifier.wake())
            .wait()?;
        let status = session
            .declare_publisher(keys.status())
            .congestion_control(CongestionControl::Drop)
            .priority(crate::camera::publishing::COUNTERS)
            .wait()?;
        let (notifier, notified) = (self.setup.outbox.clone(), Arc::clone(&self.notified));
        let _notice = session
            .declare_subscriber(keys.changed())
            .callback(move |sample| {
                let revision =
                    albireo_wire::read::<albireo_wire::ConfigChanged>(&sample.payload().to_bytes())
                        .map_or(1, |notice| notice.revision.max(1));
                notified.fetch_max(revision, Ordering::AcqRel);
                notifier.wake();
            })
            .wait()?;
        let mut shown = None;
        let _alive = match &self.setup.way {
            Way::Own(uplink) if uplink.liveliness => {
                Some(session.liveliness().declare_token(keys.alive()).wait()?)
            }
            _ => None,
        };

        let mut revision = 0;
        let mut last_try = None;
        self.pull_due = true;
        self.gathering.begin();
        loop {
            let stopping = self.stop.load(Ordering::Acquire);
            self.look_after_disk();
            let connected = reports.matching_status().wait()?.matching();
            if self.notified.swap(0, Ordering::AcqRel) > 0 {
                self.pull_due = true;
            }
            if !stopping {
                self.tell_status(&status)?;
                self.watched.serve(session, &self.setup, &mut shown)?;
                if self.pull_due && pulls.matching_status().wait()?.matching() {
                    self.pull(&pulls);
                }
            }
            let mut again = false;
            // Once the node stops, a pause is over: there is no later.
            let last_chance = stopping && last_try.is_none();
            let now = Instant::now();
            let waiting = self.setup.outbox.counts().waiting;
            let worth_it = self.gathering.is_worth_it(waiting, now)
                || (waiting > 0 && self.watched.is_on(now));
            if connected && (last_chance || (worth_it && self.delivery.is_due(now))) {
                again = self.deliver(&reports);
            }
            if stopping {
                let until = *last_try.get_or_insert_with(|| Instant::now() + LAST_TRY);
                if !again || Instant::now() >= until {
                    return Ok(Served::Stopped);
                }
            }
            if let Way::Own(uplink) = &self.setup.way {
                let stale = Duration::from_secs(uplink.reopen_s.max(10));
                if !worth_it {
                    self.last_answer = Instant::now();
                } else if self.last_answer.elapsed() > stale {
                    return Ok(Served::Stale);
                }
            }
            if !again {
                let now = Instant::now();
                let mut until = now + LOOK;
                if connected {
                    until = self.delivery.next_look(now, until);
                }
                revision = self.setup.outbox.wait_for_change(revision, until);
            }
        }
    }

    /// Sends the oldest batch; whether there may be more to send at once.
    fn deliver(&mut self, reports: &Querier<'_>) -> bool {
        let patience = Patience {
            stop: &self.stop,
            then: LAST_TRY,
        };
        let delivered = self.delivery.send(reports, patience);
        if delivered.answered {
            self.last_answer = Instant::now();
        }
        if delivered.again {
            self.gathering.sent();
        }
        if delivered.new_instance {
            self.teller.full_is_due();
        }
        if let Some(desired) = &delivered.desired {
            self.take(desired);
        }
        delivered.again
    }

    fn pull(&mut self, pulls: &Querier<'_>) {
        let request = PullRequest {
            v: VERSION,
            instance: self.setup.outbox.instance(),
            revision: self.setup.desired.revision(),
        };
        let Ok(json) = serde_json::to_vec(&request) else {
            return;
        };
        let timeout = Duration::from_millis(self.setup.config.answer_timeout_ms);
        let patience = Patience {
            stop: &self.stop,
            then: LAST_TRY,
        };
        match ask::<Desired>(pulls, json, timeout, patience) {
            Asked::Answered(desired) => {
                self.pull_due = false;
                self.last_answer = Instant::now();
                self.take(&desired);
            }
            Asked::Refused(refusal) => tracing::debug!(refusal.detail, "nothing pulled"),
            Asked::Nobody(reason) => tracing::debug!(reason, "nothing pulled"),
        }
    }

    fn take(&mut self, desired: &Desired) {
        if self
            .setup
            .desired
            .take(desired, &self.setup.board, &self.setup.outbox)
        {
            self.teller.full_is_due();
        }
        if desired.send_full_status {
            self.teller.full_is_due();
        }
        if let Some(seconds) = desired.watched_for_s {
            self.watched.extend(seconds);
        }
    }

    fn tell_status(&mut self, status: &zenoh::pubsub::Publisher<'_>) -> zenoh::Result<()> {
        let period = Duration::from_secs(self.setup.config.status_s.max(1));
        let message = self.teller.due(
            period,
            &self.setup.board,
            &self.setup.outbox,
            &self.setup.desired,
        );
        match message {
            Ok(Some(payload)) => status.put(payload).wait(),
            _ => Ok(()),
        }
    }
}
