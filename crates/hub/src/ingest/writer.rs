//! The queue of batches, the thread that parses them, and the thread that commits them and queues the answers.

use super::decode::{Batch, decode};
use super::limits::{BUSY_RETRY, NodeLimits};
use super::outcomes::Written;
use super::recorder::{Recorded, Recorder};
use super::replies::Replies;
use crate::config::HubConfig;
use crate::http::HubView;
use crate::per_node::Place;
use crate::store::{Store, StoreError};
use albireo_service::clock::{Now, unix_milliseconds};
use albireo_wire::{NodeKeys, RefusalReason};
use bytes::Bytes;
use futures_util::FutureExt;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};
use tokio::task::spawn_blocking;
use zenoh::query::Query;

/// Largest compressed batch, bytes: ten times as large as those that nodes send.
const LARGEST_PAYLOAD: usize = 1 << 20;

/// The reason for a refusal when the queue is full.
const FULL: &str = "too many batches wait to be written";

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

/// A batch that waits.
#[derive(Debug)]
struct Waiting {
    /// Its compressed bytes.
    payload: Bytes,
    /// The query to answer.
    query: Query,
    /// When it arrived.
    since: Instant,
    /// Its node.
    node: String,
    /// Its places: among the batches of its node, among all batches, and for its bytes.
    _places: [Place; 3],
}

/// What Zenoh's threads, which put batches into the queue, and the thread that writes them share.
#[derive(Clone)]
struct Shared {
    limits: Arc<NodeLimits>,
    replies: Replies,
    view: HubView,
}

impl Shared {
    /// Refuses a batch; the node may retry after `wait`.
    fn refuse(&self, query: Query, reason: RefusalReason, why: &str, wait: Option<Duration>) {
        self.view.ingest.refuse(reason);
        self.replies.refuse(query, reason, why, wait);
    }

    /// Queues a batch, or refuses it. Never waits.
    fn take(&self, mut query: Query, queue: &Sender<Waiting>) {
        let now = Instant::now();
        let counters = &self.view.ingest;
        let node = NodeKeys::node_of(query.key_expr().as_str()).map(str::to_owned);
        let payload = query.payload_mut().map(std::mem::take);
        let (Some(node), Some(payload)) = (node, payload) else {
            // The sender is not a node, and gets no answer.
            return counters.refuse(RefusalReason::Unreadable);
        };
        if payload.len() > LARGEST_PAYLOAD {
            let detail = format!("the batch has more than {LARGEST_PAYLOAD} bytes");
            return self.refuse(query, RefusalReason::Unreadable, &detail, None);
        }
        let place = match self.limits.admit(&node, now) {
            Ok(place) => place,
            Err((wait, why)) => return self.refuse(query, RefusalReason::Busy, why, Some(wait)),
        };
        let Some([batch, bytes]) = counters.queue(payload.len()) else {
            return self.refuse(query, RefusalReason::Busy, FULL, Some(BUSY_RETRY));
        };
        // A copy, so that a waiting batch holds no network buffers.
        let payload = Bytes::copy_from_slice(&payload.to_bytes());
        let waiting = Waiting {
            _places: [place, batch, bytes],
            payload,
            query,
            since: now,
            node,
        };
        // Without a writer the hub is stopping: the node gets no answer, and sends the batch again.
        let _ = queue.send(waiting);
    }
}

/// Starts the threads, and returns what queues a batch for them. Once that is dropped and the queue is empty, the threads end
/// and the returned future completes.
pub(crate) fn start(
    config: &HubConfig,
    view: &HubView,
    store: &Store,
    replies: &Replies,
) -> (impl Fn(Query) + use<>, impl Future<Output = ()> + use<>) {
    // It is bounded by the places in `IngestCounters`.
    let (queue, waiting) = channel();
    // A group is handed over when the one before it is written.
    let (groups, parsed) = sync_channel(0);
    let pause = Duration::from_millis(config.ingest.commit_ms);
    spawn_blocking(move || gather(&waiting, &groups, pause));
    let shared = Shared {
        limits: Arc::new(NodeLimits::new(config.ingest.camera_bytes_per_day)),
        replies: replies.clone(),
        view: view.clone(),
    };
    let writer = Writer {
        recorder: Recorder::new(store, &config.history, Now::system()),
        shared: shared.clone(),
    };
    let writing = spawn_blocking(move || writer.run(&parsed));
    (move |query| shared.take(query, &queue), writing.map(drop))
}

/// Batches, each parsed, or with the reason that it cannot be read.
type Group = Vec<(Waiting, Result<Batch, String>)>;

/// Parses batches and hands them over in groups, at most one in each `pause`, until the queue is dropped and empty. Without
/// batches it hands over empty groups, with which changes of presence are written.
fn gather(queue: &Receiver<Waiting>, groups: &SyncSender<Group>, pause: Duration) {
    let mut due = Instant::now();
    let mut ended = false;
    while !ended {
        let mut next = queue.recv_timeout(IDLE.max(pause));
        ended = matches!(next, Err(RecvTimeoutError::Disconnected));
        let mut group = Group::new();
        let mut reports = 0;
        let mut bytes = 0;
        while let Ok(waiting) = next {
            let batch = decode(&waiting.node, &waiting.payload, unix_milliseconds());
            reports += batch.as_ref().map_or(0, |batch| batch.reports.len());
            bytes += batch.as_ref().map_or(0, |batch| batch.bytes);
            group.push((waiting, batch));
            if reports >= COMMIT_REPORTS || bytes >= COMMIT_BYTES {
                break;
            }
            next = queue.recv_timeout(due.saturating_duration_since(Instant::now()));
        }
        // Without a writer the hub is stopping.
        ended |= groups.send(group).is_err();
        due = Instant::now() + pause;
    }
}

/// Commits batches and changes of presence.
struct Writer {
    recorder: Recorder,
    shared: Shared,
}

impl Writer {
    /// Runs until no more groups come.
    fn run(mut self, groups: &Receiver<Group>) {
        for group in groups {
            let first = group.first();
            let since = first.map_or_else(Instant::now, |(oldest, _)| oldest.since);
            self.shared.view.ingest.writing(Some(since));
            let mut waiting = Vec::new();
            let mut batches = Vec::new();
            for (one, batch) in group {
                match batch {
                    Ok(batch) => {
                        self.shared.limits.charge(&one.node, batch.bytes);
                        waiting.push(one);
                        batches.push(batch);
                    }
                    Err(error) => self.unreadable(one, &error),
                }
            }
            self.commit(waiting, &batches);
            self.shared.view.ingest.writing(None);
        }
    }

    fn unreadable(&mut self, Waiting { node, query, .. }: Waiting, error: &str) {
        self.shared.limits.charge(&node, UNREADABLE_COST);
        self.recorder.unreadable(&node, error, unix_milliseconds());
        self.shared.refuse(query, RefusalReason::Unreadable, error, None);
    }

    /// Commits a group of batches, and the changes of presence: also without either, so that an absent database is
    /// noticed. If the database refuses the group, commits each batch separately.
    fn commit(&mut self, waiting: Vec<Waiting>, batches: &[Batch]) {
        let error = match self.record(batches) {
            Ok(recorded) => return self.acknowledge(waiting, recorded),
            Err(error) => error,
        };
        let outcomes = &self.shared.view.ingest.outcomes;
        if error.passes() || batches.len() < 2 {
            outcomes.failed(&error, !batches.is_empty(), Instant::now());
            return self.unavailable(waiting, &error);
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
                    let outcomes = &self.shared.view.ingest.outcomes;
                    outcomes.failed(&error, true, Instant::now());
                    self.unavailable(vec![waiting], &error);
                }
            }
        }
        // A single batch that the database does not accept says nothing about the others.
        if is_any_stored {
            let outcomes = &self.shared.view.ingest.outcomes;
            outcomes.committed(Written::Reports, Instant::now());
        }
    }

    /// Stores batches and changes of presence in one transaction.
    fn record(&mut self, batches: &[Batch]) -> Result<Recorded, StoreError> {
        let view = &self.shared.view;
        let begun = Instant::now();
        if view.ingest.outcomes.begin(begun) {
            self.recorder.prove_writing();
        }
        let nodes = view.fleet.take_dirty();
        let done = self.recorder.record(batches, &nodes, Now::system());
        match &done {
            Ok(recorded) => {
                view.ingest.outcomes.committed(recorded.written, Instant::now());
                if !batches.is_empty() {
                    view.ingest.committed_in.add(begun.elapsed());
                }
            }
            Err(error) => {
                view.ingest.count(|counts| counts.database_errors += 1);
                tracing::error!(%error, batches = batches.len(), "nothing was committed");
                view.fleet.give_back(nodes);
            }
        }
        done
    }

    /// Refuses batches that were not stored, and pauses if the database is not available.
    fn unavailable(&self, waiting: Vec<Waiting>, error: &StoreError) {
        let retry = Some(UNAVAILABLE_RETRY);
        for waiting in waiting {
            self.shared.refuse(
                waiting.query,
                RefusalReason::Unavailable,
                &error.to_string(),
                retry,
            );
        }
        if error.passes() {
            std::thread::sleep(DATABASE_PAUSE);
        }
    }

    fn acknowledge(&self, waiting: Vec<Waiting>, recorded: Recorded) {
        let HubView { fleet, ingest, .. } = &self.shared.view;
        ingest.count(|counts| {
            *counts += recorded.counts;
            counts.commits += 1;
            counts.batches += waiting.len() as u64;
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
}
