//! The queue of batches, which bounds what may wait.

use super::counters::IngestCounters;
use super::limits::{BUSY_RETRY, NodeLimits};
use crate::per_node::Place;
use albireo_wire::{RefusalReason, ReportAnswer};
use bytes::Bytes;
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};
use zenoh::bytes::ZBytes;

/// Largest compressed batch, bytes: ten times as large as those that nodes send.
const LARGEST_PAYLOAD: usize = 1 << 20;

/// The reason for a refusal when the queue is full.
const FULL: &str = "too many batches wait to be written";

/// The reason that a batch was not stored, or a pull not answered.
#[derive(Debug)]
pub(crate) struct Refusal {
    pub(crate) reason: RefusalReason,
    /// The reason in words.
    pub(crate) why: String,
    /// The time after which the node may try again, if it may.
    pub(crate) wait: Option<Duration>,
}

impl Refusal {
    /// The refusal of a batch for which there is no room now.
    fn busy(why: &str, wait: Duration) -> Self {
        Self {
            reason: RefusalReason::Busy,
            why: why.to_owned(),
            wait: Some(wait),
        }
    }

    /// The refusal of what nobody can read; it would be refused again.
    pub(crate) fn unreadable(why: String) -> Self {
        Self {
            reason: RefusalReason::Unreadable,
            why,
            wait: None,
        }
    }
}

/// Answers a batch.
pub(crate) type OnOutcome = Box<dyn FnOnce(Result<ReportAnswer, Refusal>) + Send>;

/// A batch that waits.
pub(super) struct Waiting {
    /// Its compressed bytes.
    pub(super) payload: Bytes,
    pub(super) reply: OnOutcome,
    /// When it arrived.
    pub(super) since: Instant,
    /// Its node.
    pub(super) node: String,
    /// Its places: among the batches of its node, among all batches, and for its bytes.
    _places: [Place; 3],
}

/// Queues batches for the writer. Once it is dropped and the queue is empty, the writer ends.
pub(crate) struct Inbox {
    pub(super) limits: Arc<NodeLimits>,
    pub(super) counters: Arc<IngestCounters>,
    /// It is bounded by the places in the counters.
    pub(super) queue: Sender<Waiting>,
}

impl Inbox {
    /// Queues the batch of a node, or refuses it. Never waits.
    pub(crate) fn take(&self, node: String, payload: &ZBytes, reply: OnOutcome) {
        match self.place(&node, payload) {
            Ok(places) => {
                let waiting = Waiting {
                    // A copy, so that a waiting batch holds no network buffers.
                    payload: Bytes::copy_from_slice(&payload.to_bytes()),
                    reply,
                    since: Instant::now(),
                    node,
                    _places: places,
                };
                // Without a writer the hub is stopping: the node gets no answer, and sends the batch again.
                let _ = self.queue.send(waiting);
            }
            Err(refusal) => {
                self.counters.refuse(refusal.reason);
                reply(Err(refusal));
            }
        }
    }

    /// Takes the places of a batch.
    fn place(&self, node: &str, payload: &ZBytes) -> Result<[Place; 3], Refusal> {
        if payload.len() > LARGEST_PAYLOAD {
            let why = format!("the batch has more than {LARGEST_PAYLOAD} bytes");
            return Err(Refusal::unreadable(why));
        }
        let own = self
            .limits
            .admit(node, Instant::now())
            .map_err(|busy| Refusal::busy(busy.why, busy.retry_after))?;
        let [batch, bytes] = self
            .counters
            .queue(payload.len())
            .ok_or_else(|| Refusal::busy(FULL, BUSY_RETRY))?;
        Ok([own, batch, bytes])
    }
}
