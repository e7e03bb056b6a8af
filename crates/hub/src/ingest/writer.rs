//! The threads of ingest: one reads what waits, the other commits it and lets the answers go.

use super::commit::{Committed, Numbers, write};
use super::decode::{Batch, decode};
use super::limits::{ClockCheck, EventLimits, NodeLimits};
use super::{IngestCounters, Replies, ReportQueue, Waiting, refusal};
use crate::config::{HistoryConfig, IngestConfig};
use crate::desired::Desires;
use crate::events::EventsChanged;
use crate::presence::{Fleet, News};
use crate::readiness::Readiness;
use crate::store::retention::{STEP, retain};
use crate::store::{Database, Store, StoreError};
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{RefusalReason, ReportAnswer};
use std::future::Future;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use uuid::Uuid;

/// Time between two looks for what is too old, when nothing was found.
const RETENTION: Duration = Duration::from_secs(60);

/// Presence is written also when no report comes.
const IDLE: Duration = Duration::from_millis(250);

/// Pause after the database could not be used.
const DATABASE_PAUSE: Duration = Duration::from_millis(500);

/// Batches that are read and wait to be committed.
const READY: usize = 16;

/// What a batch that cannot be read costs its node, bytes.
const UNREADABLE_COST: usize = 64 << 10;

/// Bytes of JSON of the batches of one commit.
const COMMIT_BYTES: usize = 16 << 20;

/// What the threads need.
pub(crate) struct WriterSetup {
    pub(crate) config: IngestConfig,
    pub(crate) history: HistoryConfig,
    pub(crate) store: Store,
    pub(crate) replies: Replies,
    pub(crate) counters: Arc<IngestCounters>,
    pub(crate) readiness: Arc<Readiness>,
    pub(crate) fleet: Arc<Fleet>,
    pub(crate) desires: Arc<Desires>,
    pub(crate) events: EventsChanged,
}

/// Starts the threads. They end when the queue is dropped and empty; what is returned beside it is ready then.
///
/// # Errors
/// When the system gives no thread.
pub(crate) fn start(
    setup: WriterSetup,
) -> std::io::Result<(ReportQueue, impl Future<Output = ()>)> {
    let camera_bytes = setup.config.camera_bytes_per_day;
    let busy_retry = Duration::from_millis(setup.config.busy_retry_ms);
    let limits = NodeLimits::new(camera_bytes, busy_retry);
    let (queue, waiting) = ReportQueue::new(
        &setup.config,
        Arc::clone(&limits),
        setup.replies.clone(),
        Arc::clone(&setup.counters),
    );
    let (sender, ready) = sync_channel(READY);
    let reader = Reader {
        limits: Arc::clone(&limits),
        replies: setup.replies.clone(),
        counters: Arc::clone(&setup.counters),
        fleet: Arc::clone(&setup.fleet),
        event_limits: EventLimits::default(),
        ready: sender,
    };
    let database = setup.store.database();
    let writer = Writer {
        database,
        identity: None,
        limits,
        numbers: Numbers::default(),
        event_limits: EventLimits::default(),
        clock: ClockCheck::new(Instant::now(), unix_milliseconds()),
        retention_due: Instant::now(),
        setup,
    };
    let reading = thread("reports", move || reader.run(&waiting))?;
    let writing = thread("writer", move || writer.run(&ready))?;
    let ended = async move {
        let _ = reading.await;
        let _ = writing.await;
    };
    Ok((queue, ended))
}

/// A thread whose end can be awaited.
fn thread(
    name: &str,
    run: impl FnOnce() + Send + 'static,
) -> std::io::Result<oneshot::Receiver<()>> {
    let (running, ended) = oneshot::channel();
    let builder = std::thread::Builder::new().name(name.to_owned());
    builder.spawn(move || {
        let _running: oneshot::Sender<()> = running;
        run();
    })?;
    Ok(ended)
}

/// Reads batches.
struct Reader {
    limits: Arc<NodeLimits>,
    replies: Replies,
    counters: Arc<IngestCounters>,
    fleet: Arc<Fleet>,
    event_limits: EventLimits,
    ready: SyncSender<(Waiting, Batch)>,
}

impl Reader {
    fn run(mut self, queue: &Receiver<Waiting>) {
        while let Ok(waiting) = queue.recv() {
            let node = waiting.place.node();
            match decode(node, &waiting.payload, unix_milliseconds()) {
                Ok(batch) => {
                    self.limits.charge(node, batch.bytes);
                    if self.ready.send((waiting, batch)).is_err() {
                        return;
                    }
                }
                Err(error) => {
                    self.limits.charge(node, UNREADABLE_COST);
                    let (reason, error) = (RefusalReason::Unreadable, error.to_string());
                    self.counters.refuse(reason);
                    let now_ms = unix_milliseconds();
                    if self.event_limits.is_first(node, "refused", now_ms) {
                        tracing::warn!(node, error, "a batch cannot be read");
                        self.fleet.unreadable(node, &error, now_ms);
                    }
                    self.replies
                        .refuse(waiting.query, refusal(reason, error, None));
                }
            }
        }
    }
}

/// Commits batches, and what presence has for the database.
struct Writer {
    setup: WriterSetup,
    database: Box<dyn Database>,
    identity: Option<Uuid>,
    limits: Arc<NodeLimits>,
    numbers: Numbers,
    event_limits: EventLimits,
    clock: ClockCheck,
    retention_due: Instant,
}

impl Writer {
    /// Runs until nothing is read any more.
    fn run(mut self, ready: &Receiver<(Waiting, Batch)>) {
        let pause = Duration::from_millis(self.setup.config.commit_ms);
        loop {
            let first = ready.recv_timeout(IDLE.max(pause));
            let begun = Instant::now();
            let ended = matches!(first, Err(RecvTimeoutError::Disconnected));
            let (mut waiting, mut batches) = (Vec::new(), Vec::new());
            let (mut reports, mut bytes) = (0, 0);
            let mut next = first.ok();
            while let Some((one, batch)) = next {
                self.setup.counters.in_hand(Some(one.since));
                reports += batch.reports.len();
                bytes += batch.bytes;
                waiting.push(one);
                batches.push(batch);
                let full = reports >= self.setup.config.commit_reports || bytes >= COMMIT_BYTES;
                next = if full { None } else { ready.try_recv().ok() };
            }
            self.commit(waiting, &batches);
            self.setup.counters.in_hand(None);
            if ended {
                return;
            }
            std::thread::sleep(pause.saturating_sub(begun.elapsed()));
        }
    }

    /// Commits a group of batches; where the database takes no group, each batch alone.
    fn commit(&mut self, waiting: Vec<Waiting>, batches: &[Batch]) {
        let retention = self.retention_due <= Instant::now();
        // Until a first transaction has succeeded an empty one is tried: a database that only reads is found at the start.
        let is_proven = self.identity.is_some();
        if is_proven && batches.is_empty() && !retention && !self.setup.fleet.has_news() {
            return;
        }
        match self.transaction(batches, retention) {
            Ok(committed) => {
                self.setup.readiness.release("database");
                self.acknowledge(waiting, batches, committed);
            }
            Err(error) if !error.passes() && batches.len() > 1 => {
                tracing::error!(%error, "a group of batches is refused; each is tried alone");
                for (waiting, batch) in waiting.into_iter().zip(batches) {
                    let (waiting, alone) = (vec![waiting], std::slice::from_ref(batch));
                    match self.transaction(alone, false) {
                        Ok(committed) => self.acknowledge(waiting, alone, committed),
                        Err(error) => self.refuse(waiting, &error),
                    }
                }
            }
            Err(error) => {
                self.refuse(waiting, &error);
                if error.passes() {
                    self.setup.readiness.hold("database", &error.to_string());
                    std::thread::sleep(DATABASE_PAUSE);
                }
            }
        }
    }

    fn transaction(&mut self, batches: &[Batch], retention: bool) -> Result<Committed, StoreError> {
        let begun = Instant::now();
        let news = self.setup.fleet.take_news();
        let done = self.try_transaction(batches, &news, retention);
        let counters = &self.setup.counters;
        match &done {
            Ok(_) => {
                counters.commits(1);
                counters.committed_in(begun.elapsed());
            }
            Err(error) => {
                counters.database_errors(1);
                tracing::error!(%error, batches = batches.len(), "nothing was committed");
                self.setup.fleet.give_back(news);
                // What was handed out under this transaction means nothing any more.
                self.numbers.forget();
                self.database.disconnect();
            }
        }
        done
    }

    fn try_transaction(
        &mut self,
        batches: &[Batch],
        news: &News,
        retention: bool,
    ) -> Result<Committed, StoreError> {
        let identity = match self.identity {
            Some(identity) => identity,
            None => self.database.identity()?,
        };
        let now_ms = unix_milliseconds();
        let mut writing = self.database.begin()?;
        let (numbers, limits) = (&mut self.numbers, &mut self.event_limits);
        let mut events = news.write(&mut *writing, numbers, now_ms)?;
        let mut committed = write(&mut *writing, numbers, limits, batches, now_ms)?;
        events.append(&mut committed.events);
        let mut deleted = 0;
        if retention && self.clock.is_believed(Instant::now(), now_ms) {
            deleted = retain(&mut *writing, &self.setup.history, now_ms)?;
        }
        writing.events(&events)?;
        writing.commit()?;
        self.identity = Some(identity);
        if retention {
            let more = deleted >= STEP.unsigned_abs();
            let pause = if more { Duration::ZERO } else { RETENTION };
            self.retention_due = Instant::now() + pause;
        }
        committed.events = events;
        Ok(committed)
    }

    fn acknowledge(&mut self, waiting: Vec<Waiting>, batches: &[Batch], committed: Committed) {
        let (setup, counters) = (&self.setup, &self.setup.counters);
        counters.clips(committed.clips);
        counters.again(committed.again);
        counters.set_aside(committed.set_aside);
        counters.too_old(committed.too_old);
        counters.missing(committed.missing);
        counters.resets(committed.resets);
        counters.clock_off(committed.clock_off);
        counters.frames(committed.frames);
        counters.frames_skipped(committed.skipped);
        counters.audit_frames(committed.audit.frames);
        counters.audit_missed(committed.audit.missed);
        counters.audit_detected(committed.audit.detected);
        counters.audit_shown(committed.audit.shown);
        counters.audit_paired(committed.audit.paired);
        counters.energy_uj(committed.energy_uj);
        if !committed.events.is_empty() {
            setup.events.tell();
        }
        for batch in batches {
            self.clock.hear(&batch.node, batch.clocks_agree);
            setup.fleet.reported(&batch.node, unix_milliseconds());
        }
        for (place, at_ms, used) in committed.used {
            if let Some(batch) = batches.get(place) {
                setup.fleet.used(&batch.node, at_ms, used);
            }
        }
        let outcomes = batches.iter().zip(committed.outcomes);
        for (waiting, (batch, outcome)) in waiting.into_iter().zip(outcomes) {
            self.limits.has_cameras(&batch.node, outcome.cameras);
            counters.batches(1);
            counters.acknowledged_after(waiting.since.elapsed());
            let mut desired = setup.desires.of(&batch.node);
            desired.send_full_status = setup.fleet.needs_full_status(&batch.node);
            let answer = ReportAnswer {
                refused: outcome.refused,
                missing: outcome.wanted,
                desired: Some(desired),
                ..ReportAnswer::new(self.identity.unwrap_or_default())
            };
            setup.replies.answer(waiting.query, &answer);
        }
    }

    fn refuse(&self, waiting: Vec<Waiting>, error: &StoreError) {
        let reason = RefusalReason::Unavailable;
        for waiting in waiting {
            self.setup.counters.refuse(reason);
            let retry = Some(self.setup.config.unavailable_retry_ms);
            let refusal = refusal(reason, error.to_string(), retry);
            self.setup.replies.refuse(waiting.query, refusal);
        }
    }
}
