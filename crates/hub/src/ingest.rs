//! Takes the nodes' reports, each exactly once.
//!
//! Zenoh's thread only hands a query over to a bounded queue, and answers "busy" when it is full. One task commits
//! what waits, at most every `ingest.commit_ms`, and the answer goes out after the commit: so a slow or absent
//! database holds acknowledgements back, and never fills the memory.

mod clip;
mod commit;
mod counters;
mod decode;
#[cfg(test)]
mod fuzz;
mod plan;
mod replies;
#[cfg(test)]
mod tests;
mod writer;

pub(crate) use commit::Numbers;
pub(crate) use counters::Queued;
pub use counters::{IngestCounters, IngestSnapshot};
pub(crate) use replies::{Replies, refusal};
pub(crate) use writer::{IngestWriter, WriterSetup};

use crate::config::IngestConfig;
use albireo_wire::{FleetKeys, RefusalReason};
use bytes::Bytes;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use zenoh::query::Query;

/// A batch that waits.
#[derive(Debug)]
pub(crate) struct Waiting {
    /// The node of the key.
    pub(crate) node: String,
    /// What it sent.
    pub(crate) payload: Bytes,
    /// To be answered.
    pub(crate) query: Query,
    /// When it came.
    pub(crate) since: Instant,
    /// Its place among the bytes that may wait.
    _room: OwnedSemaphorePermit,
    /// Its place among those that are counted.
    _queued: Queued,
}

/// What Zenoh calls for each batch.
#[derive(Debug)]
pub(crate) struct Intake {
    queue: mpsc::Sender<Waiting>,
    room: Arc<Semaphore>,
    room_bytes: usize,
    replies: Replies,
    busy_after: Duration,
    busy_retry_ms: u64,
    counters: Arc<IngestCounters>,
}

impl Intake {
    /// An intake and the other end of its queue.
    pub(crate) fn new(
        config: &IngestConfig,
        replies: Replies,
        counters: Arc<IngestCounters>,
    ) -> (Self, mpsc::Receiver<Waiting>) {
        let (queue, waiting) = mpsc::channel(config.queue);
        let room_bytes = config.queue_bytes.min(u32::MAX as usize);
        let intake = Self {
            queue,
            room: Arc::new(Semaphore::new(room_bytes)),
            room_bytes,
            replies,
            busy_after: Duration::from_millis(config.busy_after_ms),
            busy_retry_ms: config.busy_retry_ms,
            counters,
        };
        (intake, waiting)
    }

    /// Takes a query over. Never waits.
    pub(crate) fn take(&self, mut query: Query) {
        let node = FleetKeys::node_of(query.key_expr().as_str()).map(str::to_owned);
        let payload = query.payload_mut().map(std::mem::take);
        let (Some(node), Some(payload)) = (node, payload) else {
            self.counters.refuse(RefusalReason::Unreadable);
            let detail = "a query without a payload or for no single node";
            return self
                .replies
                .refuse(query, refusal(RefusalReason::Unreadable, detail, None));
        };
        // Written in time or not at all: what a node has given up waiting for it sends again.
        if self.counters.waited() > self.busy_after {
            return self.busy(query);
        }
        // A copy, so that what waits holds no buffers of the network.
        let payload = Bytes::copy_from_slice(&payload.to_bytes());
        let needed = u32::try_from(payload.len().clamp(1, self.room_bytes)).unwrap_or(u32::MAX);
        let Ok(room) = Arc::clone(&self.room).try_acquire_many_owned(needed) else {
            return self.busy(query);
        };
        let queued = self.counters.queue(payload.len());
        let waiting = Waiting {
            node,
            payload,
            query,
            since: Instant::now(),
            _room: room,
            _queued: queued,
        };
        if let Err(error) = self.queue.try_send(waiting) {
            self.busy(error.into_inner().query);
        }
    }

    fn busy(&self, query: Query) {
        self.counters.refuse(RefusalReason::Busy);
        let refusal = refusal(
            RefusalReason::Busy,
            "too many batches wait to be written",
            Some(self.busy_retry_ms),
        );
        self.replies.refuse(query, refusal);
    }
}
