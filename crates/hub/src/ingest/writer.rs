//! Runs the threads of ingest: one parses batches, the other commits them and queues the answers.

use super::decode::{Batch, decode};
use super::limits::{EVENTS, EntryLimit, NodeLimits};
use super::recorder::{Recorded, Recorder};
use super::{MOST_BATCHES, Replies, ReportQueue, Shared, Waiting};
use crate::config::HubConfig;
use crate::http::HubView;
use crate::store::{Store, StoreError};
use albireo_service::clock::{Now, unix_milliseconds};
use albireo_wire::RefusalReason;
use std::future::Future;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};
use tokio::task::spawn_blocking;

/// Longest time between two checks for changes of presence, also without reports.
const IDLE: Duration = Duration::from_millis(250);

/// Pause after an error of the database.
const DATABASE_PAUSE: Duration = Duration::from_millis(500);

/// Most parsed batches that wait to be committed.
const READY: usize = 16;

/// The charge to a node for an unreadable batch, bytes.
const UNREADABLE_COST: usize = 64 << 10;

/// The time after which a node may retry after an error of the database.
const UNAVAILABLE_RETRY: Duration = Duration::from_secs(5);

/// Most reports per commit.
const COMMIT_REPORTS: usize = 4000;

/// Most bytes of JSON per commit.
const COMMIT_BYTES: usize = 16 << 20;

/// Starts the threads. They end once the queue is dropped and empty; then the returned future completes.
pub(crate) fn start(
    config: &HubConfig,
    view: &HubView,
    store: &Store,
    replies: &Replies,
) -> (ReportQueue, impl Future<Output = ()> + use<>) {
    let (queue, waiting) = sync_channel(MOST_BATCHES);
    let (sender, ready) = sync_channel(READY);
    let shared = Shared {
        limits: Arc::new(NodeLimits::new(config.ingest.camera_bytes_per_day)),
        replies: replies.clone(),
        view: view.clone(),
    };
    let reader = Reader {
        shared: shared.clone(),
        event_limit: EntryLimit::new(EVENTS),
        ready: sender,
    };
    let writer = Writer {
        recorder: Recorder::new(store, &config.history, Now::system()),
        pause: Duration::from_millis(config.ingest.commit_ms),
        shared: shared.clone(),
    };
    let reading = spawn_blocking(move || reader.run(&waiting));
    let writing = spawn_blocking(move || writer.run(&ready));
    let ended = async move {
        let _ = reading.await;
        let _ = writing.await;
    };
    (ReportQueue { queue, shared }, ended)
}

/// Parses batches.
struct Reader {
    shared: Shared,
    event_limit: EntryLimit,
    ready: SyncSender<(Waiting, Batch)>,
}

impl Reader {
    fn run(mut self, queue: &Receiver<Waiting>) {
        while let Ok(waiting) = queue.recv() {
            let (shared, node) = (&self.shared, &waiting.node);
            let now_ms = unix_milliseconds();
            match decode(node, &waiting.payload, now_ms) {
                Ok(batch) => {
                    shared.limits.charge(node, batch.bytes);
                    if self.ready.send((waiting, batch)).is_err() {
                        return;
                    }
                }
                Err(error) => {
                    shared.limits.charge(node, UNREADABLE_COST);
                    if self.event_limit.allows(node, "refused", now_ms) {
                        tracing::warn!(node, error, "a batch cannot be read");
                        shared.view.fleet.unreadable(node, &error, now_ms);
                    }
                    shared.refuse(waiting.query, RefusalReason::Unreadable, error, None);
                }
            }
        }
    }
}

/// Commits batches and changes of presence.
struct Writer {
    recorder: Recorder,
    /// Shortest time between two commits.
    pause: Duration,
    shared: Shared,
}

impl Writer {
    /// Runs until the reader has ended.
    fn run(mut self, ready: &Receiver<(Waiting, Batch)>) {
        loop {
            let first = ready.recv_timeout(IDLE.max(self.pause));
            let begun = Instant::now();
            let ended = matches!(first, Err(RecvTimeoutError::Disconnected));
            let (mut waiting, mut batches) = (Vec::new(), Vec::new());
            let (mut reports, mut bytes) = (0, 0);
            let mut next = first.ok();
            while let Some((one, batch)) = next {
                self.shared.view.ingest.writing(Some(one.since));
                reports += batch.reports.len();
                bytes += batch.bytes;
                waiting.push(one);
                batches.push(batch);
                let full = reports >= COMMIT_REPORTS || bytes >= COMMIT_BYTES;
                next = if full { None } else { ready.try_recv().ok() };
            }
            self.commit(waiting, &batches);
            self.shared.view.ingest.writing(None);
            if ended {
                return;
            }
            std::thread::sleep(self.pause.saturating_sub(begun.elapsed()));
        }
    }

    /// Commits a group of batches. If the database refuses the group, commits each batch separately.
    fn commit(&mut self, waiting: Vec<Waiting>, batches: &[Batch]) {
        let retention = self.recorder.retention_is_due(Instant::now());
        // At the start and after an error an empty transaction is tried, which shows whether the database can be written.
        if self.recorder.is_proven()
            && batches.is_empty()
            && !retention
            && !self.shared.view.fleet.has_news()
        {
            return;
        }
        match self.transaction(batches, retention) {
            Ok(committed) => {
                self.shared.view.readiness.part("database").works();
                self.acknowledge(waiting, batches, committed);
            }
            Err(error) if !error.passes() && batches.len() > 1 => {
                tracing::error!(%error, "the database refused a group of batches; each is tried separately");
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
                    (self.shared.view.readiness.part("database")).not_ready(error.to_string());
                    std::thread::sleep(DATABASE_PAUSE);
                }
            }
        }
    }

    fn transaction(&mut self, batches: &[Batch], retention: bool) -> Result<Recorded, StoreError> {
        let begun = Instant::now();
        let news = self.shared.view.fleet.take_news();
        let done = (self.recorder).record(batches, &news, retention, Now::system());
        let counters = &self.shared.view.ingest;
        match &done {
            Ok(_) => {
                counters.count(|counts| counts.commits += 1);
                counters.committed_in.add(begun.elapsed());
            }
            Err(error) => {
                counters.count(|counts| counts.database_errors += 1);
                tracing::error!(%error, batches = batches.len(), "nothing was committed");
                self.shared.view.fleet.give_back(news);
            }
        }
        done
    }

    fn acknowledge(&mut self, waiting: Vec<Waiting>, batches: &[Batch], recorded: Recorded) {
        let HubView { fleet, ingest, .. } = &self.shared.view;
        ingest.count(|counts| {
            *counts += recorded.counts;
            counts.batches += batches.len() as u64;
        });
        let answers = recorded.answers.into_iter().zip(recorded.cameras);
        for (waiting, (mut answer, cameras)) in waiting.into_iter().zip(answers) {
            let node = &waiting.node;
            fleet.reported(node, unix_milliseconds());
            self.shared.limits.has_cameras(node, cameras);
            ingest.acknowledged_after.add(waiting.since.elapsed());
            answer.desired = Some(self.shared.view.desired(node));
            self.shared.replies.answer(waiting.query, &answer);
        }
    }

    fn refuse(&self, waiting: Vec<Waiting>, error: &StoreError) {
        let (reason, retry) = (RefusalReason::Unavailable, Some(UNAVAILABLE_RETRY));
        for waiting in waiting {
            (self.shared).refuse(waiting.query, reason, error.to_string(), retry);
        }
    }
}
