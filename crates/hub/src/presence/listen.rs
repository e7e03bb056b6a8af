//! Receives status messages and liveliness tokens, answers pulls, and notifies nodes.
//!
//! Zenoh's threads only put messages into bounded queues. A status that finds its queue full is dropped: the next one shows a
//! gap in the numbers, and the hub asks for a full status.

use crate::config::HubConfig;
use crate::error::HubError;
use crate::http::HubView;
use crate::ingest::{IngestCounters, Replies};
use crate::per_node::{PerNode, Place};
use albireo_service::clock::unix_milliseconds;
use albireo_service::config::ZenohMode;
use albireo_wire::{
    ConfigChanged, Heartbeat, NodeKeys, PullRequest, RefusalReason, StatusMessage, VERSION,
};
use bytes::Bytes;
use std::collections::HashSet;
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::query::Queryable;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

/// Most messages that may wait.
const QUEUE: usize = 65_536;
/// Most waiting messages per node: a node sends one every 30 s, and a few when it starts.
const MOST_OF_A_NODE: usize = 16;
/// Largest status, bytes: twice the size of a status with as many cameras as a node may have.
const LARGEST_STATUS: usize = 64 << 10;
/// Most notices that may wait. Further ones are dropped: later notices, and the answers to reports, have the same
/// effect.
const NOTICES: usize = 65_536;
/// Interval at which the nodes are checked.
const SWEEP: Duration = Duration::from_secs(1);
/// The number of notices after which there is a pause: thousands of nodes must not pull at the same time.
const NOTICES_AT_ONCE: usize = 50;
const NOTICE_PAUSE: Duration = Duration::from_millis(10);

struct Message {
    node: String,
    what: What,
    _place: Place,
}

enum What {
    Status(Bytes),
    /// True if the liveliness token appeared.
    Token(bool),
}

/// The queue into which Zenoh's threads put messages.
#[derive(Clone)]
struct Inbox {
    queue: mpsc::Sender<Message>,
    places: Arc<PerNode>,
    counters: Arc<IngestCounters>,
}

impl Inbox {
    /// Queues a message, or drops it if there is no place. Never waits.
    fn put(&self, node: &str, what: What) {
        let message = self.places.place(node).map(|place| Message {
            node: node.to_owned(),
            what,
            _place: place,
        });
        if message.is_none_or(|message| self.queue.try_send(message).is_err()) {
            self.counters.count(|counts| counts.statuses_overrun += 1);
        }
    }
}

/// The hub's Zenoh declarations; dropping them undeclares them.
pub(crate) struct Listening {
    _status: Subscriber<()>,
    _tokens: Subscriber<()>,
    _pulls: Queryable<()>,
    /// Notifies nodes that they should pull their setting.
    pub(crate) notifier: Notifier,
}

/// Sends notices to nodes: the node, and the revision that it may pull.
pub type Notifier = SyncSender<(String, u64)>;

/// Declares the subscribers and the queryable. Also returns the task that handles the messages until the shutdown.
pub(crate) async fn listen(
    config: &HubConfig,
    view: &HubView,
    session: &Session,
    replies: Replies,
) -> Result<(Listening, impl Future<Output = ()> + Send + use<>), HubError> {
    let keys = config.keys()?;
    let (sender, messages) = mpsc::channel(QUEUE);
    let notifier = start_notifier(session.clone(), config.hub.prefix.clone());
    let is_client = config.zenoh.mode == ZenohMode::Client;
    let receiver = Receiver {
        messages,
        view: view.clone(),
        notifier: notifier.clone(),
        router: is_client.then(|| session.clone()),
        tokens_gone: HashSet::new(),
        alone_since: None,
    };
    let inbox = Inbox {
        queue: sender,
        places: Arc::new(PerNode::new(MOST_OF_A_NODE)),
        counters: Arc::clone(&view.ingest),
    };
    let statuses = inbox.clone();
    let status = session
        .declare_subscriber(keys.status())
        .callback(move |sample| {
            let Some(node) = NodeKeys::node_of(sample.key_expr().as_str()) else {
                return;
            };
            if sample.payload().len() > LARGEST_STATUS {
                return (statuses.counters).count(|counts| counts.statuses_unreadable += 1);
            }
            // A copy, so that a waiting status holds no network buffers.
            let payload = Bytes::copy_from_slice(&sample.payload().to_bytes());
            statuses.put(node, What::Status(payload));
        })
        .await
        .map_err(HubError::at("status messages cannot be subscribed to"))?;
    let tokens = session
        .liveliness()
        .declare_subscriber(keys.alive())
        .history(true)
        .callback(move |sample| {
            if let Some(node) = NodeKeys::node_of(sample.key_expr().as_str()) {
                // A dropped token only costs time: without it the age of the last status decides.
                inbox.put(node, What::Token(sample.kind() == SampleKind::Put));
            }
        })
        .await
        .map_err(HubError::at("liveliness tokens cannot be watched"))?;
    let asked = view.clone();
    let pulls = session
        .declare_queryable(keys.pull())
        .complete(true)
        .callback(move |query| {
            asked.ingest.count(|counts| counts.pulls += 1);
            let payload = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
            match albireo_wire::read::<PullRequest>(&payload) {
                Ok(_) => {
                    let node = NodeKeys::node_of(query.key_expr().as_str());
                    let desired = asked.desired(node.unwrap_or_default());
                    replies.answer(query, &desired);
                }
                Err(error) => {
                    let reason = RefusalReason::Unreadable;
                    replies.refuse(query, reason, error.to_string(), None);
                }
            }
        })
        .await
        .map_err(HubError::at("pulls cannot be answered"))?;
    let listening = Listening {
        _status: status,
        _tokens: tokens,
        _pulls: pulls,
        notifier,
    };
    Ok((listening, receiver.run(view.shutdown.clone())))
}

/// Starts a thread that sends notices, because a put may block. It ends when the last sender is dropped.
fn start_notifier(session: Session, prefix: String) -> Notifier {
    let (sender, notices) = sync_channel::<(String, u64)>(NOTICES);
    tokio::task::spawn_blocking(move || {
        let mut sent = 0_usize;
        while let Ok((node, revision)) = notices.recv() {
            let Ok(keys) = NodeKeys::new(&prefix, &node) else {
                continue;
            };
            let notice = ConfigChanged {
                v: VERSION,
                revision,
            };
            let payload = serde_json::to_vec(&notice).unwrap_or_default();
            let put = session
                .put(keys.changed(), payload)
                .congestion_control(CongestionControl::Drop)
                .wait();
            if let Err(error) = put {
                tracing::debug!(%error, node, "a notice was not sent");
            }
            sent += 1;
            if sent.is_multiple_of(NOTICES_AT_ONCE) {
                std::thread::sleep(NOTICE_PAUSE);
            }
        }
    });
    sender
}

/// Most messages handled at once.
const TAKEN_AT_ONCE: usize = 1024;
/// Pause after them: otherwise each of thousands of messages per second would wake this task, at the expense of Zenoh's threads.
const TAKEN_EVERY: Duration = Duration::from_millis(5);

/// Handles the queued messages.
struct Receiver {
    messages: mpsc::Receiver<Message>,
    view: HubView,
    notifier: Notifier,
    /// The session, if all nodes are reached through one router.
    router: Option<Session>,
    /// Nodes whose token disappeared since the last sweep. If the router is lost, all tokens disappear, which says
    /// nothing about the nodes.
    tokens_gone: HashSet<String>,
    /// When the router was lost.
    alone_since: Option<Instant>,
}

impl Receiver {
    async fn run(mut self, shutdown: CancellationToken) {
        let mut sweep = tokio::time::interval(SWEEP);
        let mut several = Vec::with_capacity(TAKEN_AT_ONCE);
        loop {
            tokio::select! {
                () = shutdown.cancelled() => return,
                count = self.messages.recv_many(&mut several, TAKEN_AT_ONCE) => if count == 0 {
                    return;
                },
                _ = sweep.tick() => {
                    self.sweep().await;
                    continue;
                }
            }
            let all = several.len() < TAKEN_AT_ONCE;
            for one in several.drain(..) {
                self.take(one);
            }
            if all {
                tokio::time::sleep(TAKEN_EVERY).await;
            }
        }
    }

    /// Finds nodes that became silent or offline; no node does while the router is lost.
    async fn sweep(&mut self) {
        let (now, now_ms) = (Instant::now(), unix_milliseconds());
        let gone = std::mem::take(&mut self.tokens_gone);
        let is_alone = match &self.router {
            Some(session) => session.info().transports().await.next().is_none(),
            None => false,
        };
        match (is_alone, self.alone_since) {
            (true, since) => {
                if since.is_none() {
                    tracing::warn!(
                        "the router is lost; no node can be reached until it is connected again"
                    );
                    self.alone_since = Some(now);
                }
                (self.view.readiness.part("zenoh")).not_ready("the router is not connected");
                return;
            }
            (false, Some(since)) => {
                self.view
                    .fleet
                    .pass_over(now.saturating_duration_since(since));
                self.alone_since = None;
                self.view.readiness.part("zenoh").works();
            }
            (false, None) => {}
        }
        for node in gone {
            self.view.fleet.token(&node, false, now, now_ms);
        }
        self.view.fleet.sweep(now, now_ms);
    }

    fn take(&mut self, one: Message) {
        let (now, now_ms) = (Instant::now(), unix_milliseconds());
        let Message { node, what, _place } = one;
        let fleet = &self.view.fleet;
        match what {
            What::Token(true) => {
                self.tokens_gone.remove(&node);
                fleet.token(&node, true, now, now_ms);
            }
            What::Token(false) => drop(self.tokens_gone.insert(node)),
            What::Status(payload) => {
                self.tokens_gone.remove(&node);
                let counters = &self.view.ingest;
                let ask_for_full = if Heartbeat::is_one(&payload) {
                    Heartbeat::read(&payload).map(|beat| fleet.alive(&node, beat, now, now_ms))
                } else {
                    albireo_wire::read::<StatusMessage>(&payload)
                        .map(|message| fleet.apply_status(&node, &message, now, now_ms))
                };
                match ask_for_full {
                    Ok(is_due) => {
                        counters.count(|counts| counts.statuses += 1);
                        if is_due {
                            let _ = self.notifier.try_send((node, 0));
                        }
                    }
                    Err(error) => {
                        counters.count(|counts| counts.statuses_unreadable += 1);
                        tracing::debug!(node, %error, "a status cannot be read");
                    }
                }
            }
        }
    }
}
