//! Takes the nodes' reports, each exactly once.
//!
//! Zenoh's thread only hands a query over to a bounded queue, and answers "busy" when it is full or when the node has sent
//! more than its share. One thread reads what waits, another commits it, at most every `ingest.commit_ms`, and the answer
//! goes out after the commit: so a slow or absent database holds acknowledgements back, and never fills the memory.

mod clip;
mod commit;
mod counters;
mod decode;
mod limits;
mod plan;
mod recorder;
mod replies;
#[cfg(test)]
mod tests;
mod writer;

pub(crate) use counters::Queued;
pub use counters::{IngestCounters, IngestSnapshot};
pub use decode::{Batch, DecodeError, decode};
pub(crate) use plan::Counts;
pub use recorder::{Recorded, Recorder};
pub(crate) use replies::{Replies, refusal};
pub(crate) use writer::{WriterSetup, start};

use crate::config::IngestConfig;
use crate::per_node::Place;
use albireo_wire::{NodeKeys, RefusalReason};
use bytes::Bytes;
use limits::{Admission, NodeLimits};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};
use zenoh::query::Query;

/// Largest batch as it is sent, bytes: one that a node makes is a tenth of that.
const LARGEST_PAYLOAD: usize = 1 << 20;

/// Batches that may wait, and their compressed bytes; one more is answered "busy" at once.
const MOST_BATCHES: usize = 4096;
const MOST_BYTES: u64 = 32 << 20;

/// Why a batch is refused when the queue is full.
const FULL: &str = "too many batches wait to be written";

/// A batch that waits.
#[derive(Debug)]
pub(crate) struct Waiting {
    /// What came.
    pub(crate) payload: Bytes,
    /// To be answered.
    pub(crate) query: Query,
    /// When it came.
    pub(crate) since: Instant,
    /// Its node, and its place among the batches of that.
    pub(crate) place: Place,
    /// Its place among those that are counted.
    _queued: Queued,
}

/// What Zenoh calls for each batch.
#[derive(Debug)]
pub(crate) struct ReportQueue {
    queue: SyncSender<Waiting>,
    limits: Arc<NodeLimits>,
    replies: Replies,
    busy_after: Duration,
    busy_retry: Duration,
    counters: Arc<IngestCounters>,
}

impl ReportQueue {
    /// A queue and its other end.
    pub(crate) fn new(
        config: &IngestConfig,
        limits: Arc<NodeLimits>,
        replies: Replies,
        counters: Arc<IngestCounters>,
    ) -> (Self, Receiver<Waiting>) {
        let (queue, waiting) = sync_channel(MOST_BATCHES);
        let queue = Self {
            queue,
            limits,
            replies,
            busy_after: Duration::from_millis(config.busy_after_ms),
            busy_retry: Duration::from_millis(config.busy_retry_ms),
            counters,
        };
        (queue, waiting)
    }

    /// Takes a query over. Never waits.
    pub(crate) fn take(&self, mut query: Query) {
        let now = Instant::now();
        let node = NodeKeys::node_of(query.key_expr().as_str()).map(str::to_owned);
        let payload = query.payload_mut().map(std::mem::take);
        let (Some(node), Some(payload)) = (node, payload) else {
            // It is no node, and is not answered.
            return self.counters.refuse(RefusalReason::Unreadable);
        };
        if payload.len() > LARGEST_PAYLOAD {
            self.counters.refuse(RefusalReason::Unreadable);
            if self.limits.may_refuse(&node, now) {
                let detail = format!("a batch of more than {LARGEST_PAYLOAD} bytes");
                let refusal = refusal(RefusalReason::Unreadable, detail, None);
                self.replies.refuse(query, refusal);
            }
            return;
        }
        let place = match self.limits.admit(&node, now) {
            Admission::Taken(place) => place,
            Admission::Later(Some((wait, why))) => return self.busy(query, wait, why),
            Admission::Later(None) => return self.counters.refuse(RefusalReason::Busy),
        };
        // Written in time or not at all: what a node has given up waiting for it sends again.
        let full = self.counters.queued_bytes() + payload.len() as u64 > MOST_BYTES;
        if full || self.counters.waited() > self.busy_after {
            return self.busy(query, self.busy_retry, FULL);
        }
        // A copy, so that what waits holds no buffers of the network.
        let payload = Bytes::copy_from_slice(&payload.to_bytes());
        let waiting = Waiting {
            _queued: self.counters.queue(payload.len()),
            payload,
            query,
            since: now,
            place,
        };
        if let Err(TrySendError::Full(waiting) | TrySendError::Disconnected(waiting)) =
            self.queue.try_send(waiting)
        {
            self.busy(waiting.query, self.busy_retry, FULL);
        }
    }

    fn busy(&self, query: Query, wait: Duration, why: &str) {
        self.counters.refuse(RefusalReason::Busy);
        let wait_ms = u64::try_from(wait.as_millis()).unwrap_or(u64::MAX);
        let refusal = refusal(RefusalReason::Busy, why, Some(wait_ms));
        self.replies.refuse(query, refusal);
    }
}
