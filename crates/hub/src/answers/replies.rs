//! Sends answers on a separate thread, because a reply over a slow network may block for seconds.

use crate::ingest::IngestCounters;
use crate::per_node::{PerNode, Place};
use crate::store::row::beginning;
use albireo_wire::{NodeKeys, RefusalReason, ReportRefusal, VERSION};
use serde::Serialize;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;
use tokio::task::{JoinHandle, spawn_blocking};
use zenoh::Wait;
use zenoh::query::Query;

/// Most answers that may wait. A further one is dropped: the node gets no answer, and sends its query again.
const QUEUE: usize = 16_384;
/// Most answers that may wait per node: a node that does not read its answers cannot fill the queue.
const MOST_OF_A_NODE: usize = 16;

/// A query, the answer or refusal to it, and its place.
type Reply = (Query, Result<Vec<u8>, Vec<u8>>, Place);

/// Queues answers to nodes.
#[derive(Clone, Debug)]
pub(crate) struct Replies {
    sender: SyncSender<Reply>,
    places: Arc<PerNode>,
    counters: Arc<IngestCounters>,
}

impl Replies {
    /// Starts the thread; it ends when the last sender is dropped.
    pub(crate) fn start(counters: Arc<IngestCounters>) -> (Self, JoinHandle<()>) {
        let (sender, replies) = sync_channel(QUEUE);
        let counted = Arc::clone(&counters);
        let thread = spawn_blocking(move || send(&replies, &counted));
        let replies = Self {
            sender,
            places: Arc::new(PerNode::new(MOST_OF_A_NODE)),
            counters,
        };
        (replies, thread)
    }

    /// Answers a query.
    pub(crate) fn answer(&self, query: Query, answer: &impl Serialize) {
        self.hand_over(query, serde_json::to_vec(answer).map(Ok));
    }

    /// Refuses a query; the node may retry after `wait`.
    pub(crate) fn refuse(
        &self,
        query: Query,
        reason: RefusalReason,
        why: &str,
        wait: Option<Duration>,
    ) {
        let refusal = ReportRefusal {
            v: VERSION,
            reason,
            detail: beginning(why),
            retry_after_ms: wait.and_then(|wait| u64::try_from(wait.as_millis()).ok()),
        };
        self.hand_over(query, serde_json::to_vec(&refusal).map(Err));
    }

    fn hand_over(&self, query: Query, payload: serde_json::Result<Result<Vec<u8>, Vec<u8>>>) {
        let queue = || {
            let node = NodeKeys::node_of(query.key_expr().as_str()).unwrap_or_default();
            let place = self.places.place(node)?;
            self.sender.try_send((query, payload.ok()?, place)).ok()
        };
        if queue().is_none() {
            self.counters.count(|counts| counts.answers_lost += 1);
        }
    }
}

fn send(replies: &Receiver<Reply>, counters: &IngestCounters) {
    while let Ok((query, payload, _place)) = replies.recv() {
        let sent = match payload {
            Ok(answer) => query.reply(query.key_expr().clone(), answer).wait(),
            Err(refusal) => query.reply_err(refusal).wait(),
        };
        if let Err(error) = sent {
            counters.count(|counts| counts.answers_lost += 1);
            tracing::debug!(%error, "an answer was not sent");
        }
    }
}
