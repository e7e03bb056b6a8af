//! Sends answers on a separate thread, because a reply over a slow network may block for seconds.

use crate::ingest::{IngestCounters, Refusal};
use crate::per_node::{PerNode, Place};
use crate::store::row::beginning;
use albireo_wire::{ReportRefusal, VERSION};
use serde::Serialize;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use tokio::task::{JoinHandle, spawn_blocking};
use zenoh::Wait;
use zenoh::query::Query;

/// Most answers that may wait. A further one is dropped: the node gets no answer, and sends its query again.
const QUEUE: usize = 16_384;
/// Most answers that may wait per node: a node that does not read its answers cannot fill the queue.
const MOST_OF_A_NODE: usize = 16;

/// What a query is answered with, as JSON.
enum Answer {
    Success(Vec<u8>),
    Refusal(Vec<u8>),
}

/// A query with its answer.
struct Reply {
    query: Query,
    answer: Answer,
    /// Among the answers to its node; freed when the answer is sent.
    _place: Place,
}

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
        let json = serde_json::to_vec(answer);
        self.hand_over(query, json.map(Answer::Success));
    }

    /// Refuses a query.
    pub(crate) fn refuse(&self, query: Query, refusal: &Refusal) {
        let wait = refusal.wait;
        let json = serde_json::to_vec(&ReportRefusal {
            v: VERSION,
            reason: refusal.reason,
            detail: beginning(&refusal.why),
            retry_after_ms: wait.and_then(|wait| u64::try_from(wait.as_millis()).ok()),
        });
        self.hand_over(query, json.map(Answer::Refusal));
    }

    fn hand_over(&self, query: Query, answer: serde_json::Result<Answer>) {
        if self.queue(query, answer).is_none() {
            self.counters.count(|counts| counts.answers_lost += 1);
        }
    }

    /// Queues an answer. Returns `None` if it is lost.
    fn queue(&self, query: Query, answer: serde_json::Result<Answer>) -> Option<()> {
        // Also of a name that no node may have: such senders do not share their places.
        let key = query.key_expr().as_str();
        let node = key.rsplit_once('/').map_or(key, |(_, node)| node);
        let place = self.places.place(node)?;
        let reply = Reply {
            query,
            answer: answer.ok()?,
            _place: place,
        };
        self.sender.try_send(reply).ok()
    }
}

fn send(replies: &Receiver<Reply>, counters: &IngestCounters) {
    for reply in replies {
        let query = &reply.query;
        let sent = match reply.answer {
            Answer::Success(json) => query.reply(query.key_expr().clone(), json).wait(),
            Answer::Refusal(json) => query.reply_err(json).wait(),
        };
        if let Err(error) = sent {
            counters.count(|counts| counts.answers_lost += 1);
            tracing::debug!(%error, "an answer was not sent");
        }
    }
}
