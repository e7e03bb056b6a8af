//! The threads of ingest: one reads what waits, the other commits it and lets the answers go.

use super::counters::IngestCounts;
use super::decode::{Batch, decode};
use super::limits::{EventLimits, NodeLimits};
use super::recorder::{Recorded, Recorder};
use super::{IngestCounters, Replies, ReportQueue, Waiting, refusal};
use crate::config::{HistoryConfig, IngestConfig};
use crate::desired::Desires;
use crate::presence::Fleet;
use crate::readiness::Readiness;
use crate::store::{Store, StoreError};
use albireo_service::clock::{Now, unix_milliseconds};
use albireo_wire::RefusalReason;
use std::future::Future;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};
use tokio::sync::{oneshot, watch};

/// Presence is written also when no report comes.
const IDLE: Duration = Duration::from_millis(250);

/// Pause after the database could not be used.
const DATABASE_PAUSE: Duration = Duration::from_millis(500);

/// Batches that are read and wait to be committed.
const READY: usize = 16;

/// What a batch that cannot be read costs its node, bytes.
const UNREADABLE_COST: usize = 64 << 10;

/// When a node comes again after the database could not be written, milliseconds.
const UNAVAILABLE_RETRY_MS: u64 = 5_000;

/// Reports of one commit.
const COMMIT_REPORTS: usize = 4000;

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
    pub(crate) events: watch::Sender<()>,
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
    let writer = Writer {
        recorder: Recorder::new(&setup.store, &setup.history, Now::system()),
        limits,
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
    recorder: Recorder,
    limits: Arc<NodeLimits>,
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
                let full = reports >= COMMIT_REPORTS || bytes >= COMMIT_BYTES;
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
        let retention = self.recorder.retention_is_due(Instant::now());
        // Until a first transaction has succeeded an empty one is tried: a database that only reads is found at the start.
        if self.recorder.is_proven()
            && batches.is_empty()
            && !retention
            && !self.setup.fleet.has_news()
        {
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

    fn transaction(&mut self, batches: &[Batch], retention: bool) -> Result<Recorded, StoreError> {
        let begun = Instant::now();
        let news = self.setup.fleet.take_news();
        let done = (self.recorder).record(batches, &news, retention, Now::system());
        let counters = &self.setup.counters;
        match &done {
            Ok(_) => {
                counters.add(IngestCounts {
                    commits: 1,
                    ..IngestCounts::default()
                });
                counters.committed_in(begun.elapsed());
            }
            Err(error) => {
                counters.add(IngestCounts {
                    database_errors: 1,
                    ..IngestCounts::default()
                });
                tracing::error!(%error, batches = batches.len(), "nothing was committed");
                self.setup.fleet.give_back(news);
            }
        }
        done
    }

    fn acknowledge(&mut self, waiting: Vec<Waiting>, batches: &[Batch], recorded: Recorded) {
        let Recorded { answers, committed } = recorded;
        let (setup, counters) = (&self.setup, &self.setup.counters);
        counters.add(IngestCounts {
            batches: batches.len() as u64,
            ..committed.counts
        });
        if !committed.events.is_empty() {
            setup.events.send_replace(());
        }
        for batch in batches {
            setup.fleet.reported(&batch.node, unix_milliseconds());
        }
        for (place, at_ms, used) in committed.used {
            if let Some(batch) = batches.get(place) {
                setup.fleet.used(&batch.node, at_ms, used);
            }
        }
        let outcomes = batches.iter().zip(committed.outcomes).zip(answers);
        for (waiting, ((batch, outcome), mut answer)) in waiting.into_iter().zip(outcomes) {
            self.limits.has_cameras(&batch.node, outcome.cameras);
            counters.acknowledged_after(waiting.since.elapsed());
            let mut desired = setup.desires.of(&batch.node);
            desired.send_full_status = setup.fleet.needs_full_status(&batch.node);
            answer.desired = Some(desired);
            setup.replies.answer(waiting.query, &answer);
        }
    }

    fn refuse(&self, waiting: Vec<Waiting>, error: &StoreError) {
        let reason = RefusalReason::Unavailable;
        for waiting in waiting {
            self.setup.counters.refuse(reason);
            let retry = Some(UNAVAILABLE_RETRY_MS);
            let refusal = refusal(reason, error.to_string(), retry);
            self.setup.replies.refuse(waiting.query, refusal);
        }
    }
}
