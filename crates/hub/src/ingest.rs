//! Stores the nodes' reports, each exactly once.
//!
//! Zenoh's thread only puts a query into a bounded queue, and answers "busy" when it is full or when the node has sent
//! more than its share. One thread parses the batches, another commits them, at most every `ingest.commit_ms`, and the
//! answer is sent after the commit: a slow or absent database delays acknowledgements but never fills the memory.

mod clip;
mod counters;
mod decode;
mod limits;
mod plan;
mod recorder;
mod replies;
#[cfg(test)]
mod tests;
mod writer;

use counters::Queued;
pub use counters::{IngestCounters, IngestCounts};
pub use decode::{Batch, decode};
pub(crate) use plan::Counts;
pub use recorder::{Recorded, Recorder};
pub(crate) use replies::Replies;
pub(crate) use writer::start;

use crate::http::HubView;
use crate::per_node::Place;
use albireo_wire::{NodeKeys, RefusalReason};
use bytes::Bytes;
use limits::{BUSY_RETRY, NodeLimits};
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::{Duration, Instant};
use zenoh::query::Query;

/// Largest compressed batch, bytes: ten times as large as those that nodes send.
const LARGEST_PAYLOAD: usize = 1 << 20;

/// Most batches that may wait, and most compressed bytes of them; a further batch is answered "busy" immediately.
const MOST_BATCHES: usize = 4096;
const MOST_BYTES: u64 = 32 << 20;

/// A batch that arrives while the batches being written have waited longer than this is answered "busy". This is well
/// below the time that nodes wait for an answer: a node sends a batch again that is answered later.
const BUSY_AFTER: Duration = Duration::from_secs(3);

/// The reason for a refusal when the queue is full.
const FULL: &str = "too many batches wait to be written";

/// A batch that waits.
#[derive(Debug)]
pub(crate) struct Waiting {
    /// Its compressed bytes.
    pub(crate) payload: Bytes,
    /// The query to answer.
    pub(crate) query: Query,
    /// When it arrived.
    pub(crate) since: Instant,
    /// Its node.
    pub(crate) node: String,
    /// Its place among the batches of its node, and among those counted as waiting.
    _places: (Place, Queued),
}

/// What the queue and the threads of ingest share.
#[derive(Clone)]
struct Shared {
    limits: Arc<NodeLimits>,
    replies: Replies,
    view: HubView,
}

impl Shared {
    /// Refuses a batch; the node may retry after `wait`.
    fn refuse(
        &self,
        query: Query,
        reason: RefusalReason,
        why: impl Into<String>,
        wait: Option<Duration>,
    ) {
        self.view.ingest.refuse(reason);
        self.replies.refuse(query, reason, why, wait);
    }
}

/// The queue into which Zenoh's threads put batches.
pub(crate) struct ReportQueue {
    queue: SyncSender<Waiting>,
    shared: Shared,
}

impl ReportQueue {
    /// Queues a batch, or refuses it. Never waits.
    pub(crate) fn take(&self, mut query: Query) {
        let (now, shared) = (Instant::now(), &self.shared);
        let counters = &shared.view.ingest;
        let node = NodeKeys::node_of(query.key_expr().as_str()).map(str::to_owned);
        let payload = query.payload_mut().map(std::mem::take);
        let (Some(node), Some(payload)) = (node, payload) else {
            // The sender is not a node, and gets no answer.
            return counters.refuse(RefusalReason::Unreadable);
        };
        if payload.len() > LARGEST_PAYLOAD {
            let detail = format!("the batch has more than {LARGEST_PAYLOAD} bytes");
            return shared.refuse(query, RefusalReason::Unreadable, detail, None);
        }
        let place = match shared.limits.admit(&node, now) {
            Ok(place) => place,
            Err((wait, why)) => return shared.refuse(query, RefusalReason::Busy, why, Some(wait)),
        };
        let full = |query| shared.refuse(query, RefusalReason::Busy, FULL, Some(BUSY_RETRY));
        let bytes = counters.queued_bytes() + payload.len() as u64;
        if bytes > MOST_BYTES || counters.waited() > BUSY_AFTER {
            return full(query);
        }
        // A copy, so that a waiting batch holds no network buffers.
        let payload = Bytes::copy_from_slice(&payload.to_bytes());
        let waiting = Waiting {
            _places: (place, counters.queue(payload.len())),
            payload,
            query,
            since: now,
            node,
        };
        if let Err(TrySendError::Full(waiting) | TrySendError::Disconnected(waiting)) =
            self.queue.try_send(waiting)
        {
            full(waiting.query);
        }
    }
}
