//! The thread that parses batches, and the thread that commits them and answers.

use super::counters::IngestCounters;
use super::decode::{Batch, decode};
use super::inbox::{Inbox, Refusal, Waiting};
use super::limits::NodeLimits;
use super::outcomes::Written;
use super::recorder::{Recorded, Recorder};
use crate::config::IngestConfig;
use crate::presence::Fleet;
use crate::store::StoreError;
use albireo_service::clock::{Now, unix_milliseconds};
use albireo_wire::RefusalReason;
use futures_util::FutureExt;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};
use tokio::task::spawn_blocking;

/// Longest time between two transactions, also without reports: changes of presence are written, too.
const IDLE: Duration = Duration::from_millis(250);

/// Pause after an error of the database.
const DATABASE_PAUSE: Duration = Duration::from_millis(500);

/// The charge to a node for an unreadable batch, bytes.
const UNREADABLE_COST: usize = 64 << 10;

/// The time after which a node may retry after an error of the database.
const UNAVAILABLE_RETRY: Duration = Duration::from_secs(5);

/// Most reports per commit.
const COMMIT_REPORTS: usize = 4000;

/// Most bytes of JSON per commit.
const COMMIT_BYTES: usize = 16 << 20;

/// Starts the threads with what they need. Returns the inbox, and what completes when both threads have ended: after the inbox
/// is dropped, and what waits in it is written.
pub(crate) fn start(
    config: &IngestConfig,
    recorder: Recorder,
    fleet: Arc<Fleet>,
    counters: Arc<IngestCounters>,
) -> (Inbox, impl Future<Output = ()> + use<>) {
    let (queue, waiting) = channel();
    // A group is handed over when the one before it is written.
    let (groups, parsed) = sync_channel(0);
    let pause = Duration::from_millis(config.commit_ms);
    spawn_blocking(move || gather(&waiting, &groups, pause));
    let limits = Arc::new(NodeLimits::new(config.camera_bytes_per_day));
    let inbox = Inbox {
        limits: Arc::clone(&limits),
        counters: Arc::clone(&counters),
        queue,
    };
    let writer = Writer {
        recorder,
        limits,
        fleet,
        counters,
    };
    let writing = spawn_blocking(move || writer.run(&parsed));
    (inbox, writing.map(drop))
}

/// A batch that waits, parsed, or with the reason that it cannot be read.
struct Parsed {
    waiting: Waiting,
    batch: Result<Batch, String>,
}

/// Parses batches and hands them over in groups, at most one in each `pause`, until the queue is dropped and empty. Without
/// batches it hands over empty groups, with which changes of presence are written.
fn gather(queue: &Receiver<Waiting>, groups: &SyncSender<Vec<Parsed>>, pause: Duration) {
    let mut due = Instant::now();
    loop {
        let mut next = queue.recv_timeout(IDLE.max(pause));
        let is_last = matches!(next, Err(RecvTimeoutError::Disconnected));
        let mut group = Vec::new();
        let mut reports = 0;
        let mut bytes = 0;
        while let Ok(waiting) = next {
            let batch = decode(&waiting.node, &waiting.payload, unix_milliseconds());
            if let Ok(batch) = &batch {
                reports += batch.reports.len();
                bytes += batch.bytes;
            }
            group.push(Parsed { waiting, batch });
            if reports >= COMMIT_REPORTS || bytes >= COMMIT_BYTES {
                break;
            }
            next = queue.recv_timeout(due.saturating_duration_since(Instant::now()));
        }
        let sent = groups.send(group);
        // Without a writer the hub is stopping.
        if is_last || sent.is_err() {
            return;
        }
        due = Instant::now() + pause;
    }
}

/// Commits batches and changes of presence.
struct Writer {
    recorder: Recorder,
    limits: Arc<NodeLimits>,
    fleet: Arc<Fleet>,
    counters: Arc<IngestCounters>,
}

impl Writer {
    /// Runs until no more groups come.
    fn run(mut self, groups: &Receiver<Vec<Parsed>>) {
        for group in groups {
            let since = match group.first() {
                Some(oldest) => oldest.waiting.since,
                None => Instant::now(),
            };
            self.counters.writing(Some(since));
            let mut waiting = Vec::new();
            let mut batches = Vec::new();
            for one in group {
                match one.batch {
                    Ok(batch) => {
                        self.limits.charge(&one.waiting.node, batch.bytes);
                        waiting.push(one.waiting);
                        batches.push(batch);
                    }
                    Err(error) => self.unreadable(one.waiting, error),
                }
            }
            self.commit(waiting, &batches);
            self.counters.writing(None);
        }
    }

    fn unreadable(&mut self, waiting: Waiting, error: String) {
        self.limits.charge(&waiting.node, UNREADABLE_COST);
        self.recorder.unreadable(&waiting.node, &error, unix_milliseconds());
        self.refuse(waiting, Refusal::unreadable(error));
    }

    fn refuse(&self, waiting: Waiting, refusal: Refusal) {
        self.counters.refuse(refusal.reason);
        (waiting.reply)(Err(refusal));
    }

    /// Commits a group of batches, and the changes of presence: also without either, so that an absent database is
    /// noticed. If the database refuses the group, commits each batch separately.
    fn commit(&mut self, waiting: Vec<Waiting>, batches: &[Batch]) {
        let error = match self.record(batches) {
            Ok(recorded) => {
                self.acknowledge(waiting, recorded);
                return;
            }
            Err(error) => error,
        };
        if error.is_temporary() || batches.len() < 2 {
            let had_reports = !batches.is_empty();
            self.counters.outcomes.failed(&error, had_reports, Instant::now());
            self.unavailable(waiting, &error);
            return;
        }
        let mut is_any_stored = false;
        for (waiting, batch) in waiting.into_iter().zip(batches) {
            let batch = std::slice::from_ref(batch);
            match self.record(batch) {
                Ok(recorded) => {
                    is_any_stored |= recorded.written == Written::Reports;
                    self.acknowledge(vec![waiting], recorded);
                }
                Err(error) => {
                    let had_reports = true;
                    self.counters.outcomes.failed(&error, had_reports, Instant::now());
                    self.unavailable(vec![waiting], &error);
                }
            }
        }
        // A single batch that the database does not accept says nothing about the others.
        if is_any_stored {
            self.counters.outcomes.committed(Written::Reports, Instant::now());
        }
    }

    /// Stores batches and changes of presence in one transaction.
    fn record(&mut self, batches: &[Batch]) -> Result<Recorded, StoreError> {
        let begun = Instant::now();
        if self.counters.outcomes.begin(begun) {
            self.recorder.prove_writing();
        }
        let nodes = self.fleet.take_dirty();
        let done = self.recorder.record(batches, &nodes, Now::system());
        match &done {
            Ok(recorded) => {
                self.counters.outcomes.committed(recorded.written, Instant::now());
                if !batches.is_empty() {
                    self.counters.committed_in.add(begun.elapsed());
                }
            }
            Err(error) => {
                self.counters.count(|counts| counts.database_errors += 1);
                tracing::error!(%error, batches = batches.len(), "nothing was committed");
                self.fleet.give_back(nodes);
            }
        }
        done
    }

    /// Refuses batches that were not stored, and pauses if the database is not available.
    fn unavailable(&self, waiting: Vec<Waiting>, error: &StoreError) {
        for one in waiting {
            let refusal = Refusal {
                reason: RefusalReason::Unavailable,
                why: error.to_string(),
                wait: Some(UNAVAILABLE_RETRY),
            };
            self.refuse(one, refusal);
        }
        if error.is_temporary() {
            std::thread::sleep(DATABASE_PAUSE);
        }
    }

    fn acknowledge(&self, waiting: Vec<Waiting>, recorded: Recorded) {
        self.counters.count(|counts| {
            *counts += recorded.counts;
            counts.commits += 1;
            counts.batches += waiting.len() as u64;
        });
        for (one, cameras) in waiting.iter().zip(recorded.cameras) {
            self.limits.note_cameras(&one.node, cameras);
        }
        for (one, answer) in waiting.into_iter().zip(recorded.answers) {
            self.fleet.reported(&one.node, unix_milliseconds());
            self.counters.acknowledged_after.add(one.since.elapsed());
            (one.reply)(Ok(answer));
        }
    }
}
