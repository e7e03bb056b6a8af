//! Simulates one node on a Zenoh session that it shares with others.

use super::error::SimulateError;
use super::node::SimNode;
use super::options::{Options, now_ns};
use super::random::{mix, unit};
use super::totals::{Counts, Totals};
use albireo_wire::{
    BatchCompression, Desired, NodeKeys, RefusalReason, ReportAnswer, ReportRefusal,
    RevisionMessage, VERSION, read,
};
use serde::de::DeserializeOwned;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

/// The time limit for the answer to a batch or a pull.
const ANSWER_WITHIN: Duration = Duration::from_secs(10);
/// The first and longest pause after an unacknowledged batch.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// The maximum number of reports per batch.
const MOST_REPORTS: u64 = 90;
/// The first part of every key.
const PREFIX: &str = "albireo";
/// The time within which all nodes send their first status.
const FIRST_STATUSES: Duration = Duration::from_secs(5);

/// The time after the start at which the initial flood of all nodes is over; at most a third of the run.
const SETTLED: Duration = Duration::from_secs(20);

/// The answer to a request; else the refusal, if one was received.
type Answer<T> = Result<T, Option<ReportRefusal>>;

/// A request to the hub that has ended.
enum EndedRequest {
    Pull(Answer<Desired>),
    Batch(SentBatch),
}

/// A batch of this number of reports, and the time until its answer.
struct SentBatch {
    reports: u64,
    took: Duration,
    answer: Answer<ReportAnswer>,
}

/// What is drawn from the hash of a node's name: when its messages are due within their periods.
const DRAW_FIRST_STATUS: u64 = 1;
const DRAW_FIRST_CLIP: u64 = 2;
const DRAW_SECOND_STATUS: u64 = 3;

/// Opens a client session to the endpoint, with the buffers of a node's uplink.
pub(crate) async fn open(options: &Options, index: usize) -> Result<Session, SimulateError> {
    let mut config = match &options.zenoh_config {
        Some(file) => zenoh::Config::from_file(file).map_err(SimulateError::at(file.display()))?,
        None => zenoh::Config::default(),
    };
    // The first retries are spread over time, because thousands may reconnect to a router at once.
    let first_retry = 500 + mix(options.seed, index as u64) % 2_000;
    let retry = serde_json::json!({
        "period_init_ms": first_retry, "period_max_ms": 5_000, "period_increase_factor": 2,
    });
    for (key, value) in [
        ("mode", serde_json::json!("client")),
        ("connect/endpoints", serde_json::json!([options.connect])),
        ("connect/timeout_ms", serde_json::json!(-1)),
        ("connect/exit_on_failure", serde_json::json!(false)),
        ("connect/retry", retry),
        ("listen/endpoints", serde_json::json!([])),
        ("scouting/multicast/enabled", serde_json::json!(false)),
        ("scouting/gossip/enabled", serde_json::json!(false)),
        // Same as a node's uplink.
        ("transport/shared_memory/enabled", serde_json::json!(false)),
        ("transport/link/tx/lease", serde_json::json!(120_000)),
        ("transport/link/tx/batch_size", serde_json::json!(8_192)),
        ("transport/link/rx/buffer_size", serde_json::json!(8_192)),
    ] {
        config.insert_json5(key, &value.to_string()).map_err(SimulateError::at(key))?;
    }
    let place = format!("session {index}");
    // Zenoh waits for the router without an end, and blocks its thread meanwhile.
    let opening = tokio::task::spawn_blocking(|| zenoh::open(config).wait());
    let opened = opening.await.map_err(SimulateError::at(&place))?;
    opened.map_err(SimulateError::at(&place))
}

/// Simulates one node.
pub(crate) struct Player {
    session: Session,
    node: SimNode,
    keys: NodeKeys,
    options: Arc<Options>,
    totals: Arc<Totals>,
    requests: JoinSet<EndedRequest>,
    /// True while a batch is in flight.
    is_sending: bool,
    /// The time to resend an unacknowledged batch; no other is sent before.
    resend_at: Option<Instant>,
    /// The pause after the next unacknowledged batch.
    pause: Duration,
    /// True once no more clips are made: the remaining reports are sent even if there are few.
    is_ending: bool,
}

impl Player {
    pub(crate) fn new(
        session: Session,
        node: SimNode,
        options: Arc<Options>,
        totals: Arc<Totals>,
    ) -> Result<Self, SimulateError> {
        let keys = NodeKeys::new(PREFIX, &node.name)
            .map_err(SimulateError::at("a simulated node's name"))?;
        totals.counts.lock().made += node.made;
        Ok(Self {
            session,
            node,
            keys,
            options,
            totals,
            requests: JoinSet::new(),
            is_sending: false,
            resend_at: None,
            pause: FIRST_PAUSE,
            is_ending: false,
        })
    }

    /// Runs until `end`, then sends the remaining reports.
    pub(crate) async fn play(
        mut self,
        began: Instant,
        end: CancellationToken,
    ) -> Result<(), SimulateError> {
        let notice = Arc::new(Notify::new());
        // Held until the end: dropping it ends the subscription.
        let _notices = if self.options.notices {
            Some(self.subscribe_to_notices(&notice)?)
        } else {
            None
        };
        let first_status_period = self.status_period().min(FIRST_STATUSES);
        let clip_period = Duration::from_secs_f64(self.options.clip_s);
        let mut hash = self.options.seed;
        for byte in self.node.name.bytes() {
            hash = mix(hash, byte.into());
        }
        // Spreads the times of all nodes over the period.
        let spread = |period: Duration, draw| period.mul_f64(unit(mix(hash, draw)));
        let mut next_status = began + spread(first_status_period, DRAW_FIRST_STATUS);
        let mut next_clip = began + spread(clip_period, DRAW_FIRST_CLIP);
        self.pull();
        while !(self.is_ending && self.node.waiting() == 0) {
            let resend_at = self.resend_at;
            tokio::select! {
                Some(Ok(request)) = self.requests.join_next() => self.request_ended(request, began),
                () = notice.notified() => self.pull(),
                () = sleep_until(next_status), if !self.is_ending => {
                    let period = self.status_period();
                    // All nodes are known soon; from then on, their times are spread over the whole period.
                    let is_among_first = next_status < began + FIRST_STATUSES;
                    let until_next = if is_among_first {
                        // A short draw must not lead to two statuses while the first ones of all nodes still come.
                        let shortest = FIRST_STATUSES.min(period);
                        spread(period, DRAW_SECOND_STATUS).max(shortest)
                    } else {
                        period
                    };
                    next_status += until_next;
                    self.send_status();
                }
                () = sleep_until(next_clip), if !self.is_ending => {
                    next_clip += clip_period;
                    self.make_clip();
                }
                // Without a time to resend, the branch is off, and its time counts for nothing.
                () = sleep_until(resend_at.unwrap_or(began)), if resend_at.is_some() => {
                    self.resend_at = None;
                    self.send_batch_of_at_least(1);
                }
                () = end.cancelled(), if !self.is_ending => {
                    self.is_ending = true;
                    // As in a real node that stops, the end is also the end of a pause.
                    self.resend_at = None;
                    self.send_batch_of_at_least(1);
                }
            }
        }
        Ok(())
    }

    /// The time between two statuses, which the hub may change.
    fn status_period(&self) -> Duration {
        Duration::from_secs_f64(self.node.heartbeat_s)
    }

    /// Lets `add` change the counts that all nodes share.
    fn count(&self, add: impl FnOnce(&mut Counts)) {
        add(&mut self.totals.counts.lock());
    }

    /// Forwards each notice of the hub to `notice`.
    fn subscribe_to_notices(&self, notice: &Arc<Notify>) -> Result<Subscriber<()>, SimulateError> {
        let notice = Arc::clone(notice);
        self.session
            .declare_subscriber(self.keys.changed())
            .callback(move |sample| {
                if read::<RevisionMessage>(&sample.payload().to_bytes()).is_ok() {
                    notice.notify_one();
                }
            })
            .wait()
            .map_err(SimulateError::at(format!("notice of {}", self.node.name)))
    }

    /// Makes the report of one more clip, and sends a batch if enough reports wait.
    fn make_clip(&mut self) {
        self.node.made += 1;
        self.count(|counts| counts.made += 1);
        self.send_batch_of_at_least(self.options.gather);
    }

    fn request_ended(&mut self, request: EndedRequest, began: Instant) {
        match request {
            EndedRequest::Pull(Ok(desired)) => self.apply(&desired),
            // The next notice or report brings it.
            EndedRequest::Pull(Err(_)) => {}
            EndedRequest::Batch(sent) => {
                self.is_sending = false;
                match sent.answer {
                    Ok(answer) => self.acknowledged(sent.reports, sent.took, &answer, began),
                    Err(refusal) => self.send_later(refusal),
                }
            }
        }
    }

    fn acknowledged(
        &mut self,
        reports: u64,
        took: Duration,
        answer: &ReportAnswer,
        began: Instant,
    ) {
        let is_settled = began.elapsed() >= SETTLED.min(self.options.duration / 3);
        if is_settled && !self.is_ending {
            self.totals.answers.add(took);
        }
        self.pause = FIRST_PAUSE;
        self.node.acknowledge(reports);
        self.count(|counts| counts.acknowledged += reports);
        let least = if self.is_ending {
            1
        } else {
            self.options.gather
        };
        self.send_batch_of_at_least(least);
        if let Some(desired) = &answer.desired {
            self.apply(desired);
        }
    }

    /// Schedules an unacknowledged batch for resending, after a growing pause and not before the hub's time.
    fn send_later(&mut self, refusal: Option<ReportRefusal>) {
        let reason = refusal.as_ref().map(|refusal| refusal.reason);
        self.count(|counts| match reason {
            Some(RefusalReason::Busy) => counts.busy += 1,
            Some(_) => counts.refused += 1,
            None => counts.no_reply += 1,
        });
        let hub_wants_ms = refusal.and_then(|refusal| refusal.retry_after_ms);
        let at_least = Duration::from_millis(hub_wants_ms.unwrap_or(0));
        // Half to one and a half of the pause, so that nodes refused at the same time do not come back at the same time.
        let factor = 0.5 + unit(mix(self.node.made, now_ns()));
        let pause = self.pause.mul_f64(factor).max(at_least);
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
        self.resend_at = Some(Instant::now() + pause);
    }

    fn apply(&mut self, desired: &Desired) {
        let is_status_due = self.node.apply(desired);
        if is_status_due && !self.is_ending {
            self.send_status();
        }
    }

    fn send_status(&mut self) {
        let Ok(payload) = self.node.status_payload(now_ns()) else {
            return;
        };
        let put = self
            .session
            .put(self.keys.status(), payload)
            .encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Drop);
        match put.wait() {
            Ok(()) => self.count(|counts| counts.statuses += 1),
            Err(error) => tracing::debug!(%error, "status not sent"),
        }
    }

    /// Sends the oldest reports if at least `least` wait, no batch is in flight, and none waits to be resent.
    fn send_batch_of_at_least(&mut self, least: u64) {
        let may_send = !self.is_sending && self.resend_at.is_none();
        if !may_send || self.node.waiting() < least {
            return;
        }
        let Some(batch) = self.node.batch(MOST_REPORTS, now_ns()) else {
            return;
        };
        // All simulated nodes compress in this process, so the quick level limits the cost.
        let Ok(payload) = batch.to_payload(BatchCompression::Quick) else {
            return;
        };
        self.is_sending = true;
        self.count(|counts| {
            counts.batches += 1;
            counts.batch_bytes += payload.len() as u64;
        });
        let asking = ask(self.session.clone(), self.keys.report(), payload);
        let reports = batch.reports.len() as u64;
        let sent = Instant::now();
        self.requests.spawn(async move {
            let answer = asking.await;
            let took = sent.elapsed();
            EndedRequest::Batch(SentBatch {
                reports,
                took,
                answer,
            })
        });
    }

    /// Asks for the desired settings.
    fn pull(&mut self) {
        let request = RevisionMessage {
            v: VERSION,
            revision: self.node.revision,
        };
        if let Ok(payload) = serde_json::to_vec(&request) {
            self.count(|counts| counts.pulls += 1);
            let asking = ask(self.session.clone(), self.keys.pull(), payload);
            self.requests.spawn(async { EndedRequest::Pull(asking.await) });
        }
    }
}

/// Sends a query with a payload and returns its first answer.
async fn ask<T: DeserializeOwned>(session: Session, key: String, payload: Vec<u8>) -> Answer<T> {
    let sent = session
        .get(key)
        .payload(payload)
        .encoding(Encoding::APPLICATION_JSON)
        .congestion_control(CongestionControl::Drop)
        .timeout(ANSWER_WITHIN)
        .await;
    let Ok(replies) = sent else {
        return Err(None);
    };
    let Ok(reply) = replies.recv_async().await else {
        return Err(None);
    };
    match reply.result() {
        Ok(sample) => read(&sample.payload().to_bytes()).map_err(|_| None),
        Err(error) => Err(read(&error.payload().to_bytes()).ok()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh::query::Queryable;

    const MINUTE: Duration = Duration::from_secs(60);

    /// A node with 20 reports, which it sends twelve at a time, and a hub that refuses each batch for a minute.
    struct Refused {
        player: Player,
        _hub: Queryable<()>,
    }

    impl Refused {
        async fn new() -> Self {
            let mut config = zenoh::Config::default();
            config.insert_json5("listen/endpoints", "[]").unwrap();
            config.insert_json5("scouting/multicast/enabled", "false").unwrap();
            let session = zenoh::open(config).await.unwrap();
            let options = Arc::new(Options {
                backlog: 20,
                gather: 12,
                seed: 1,
                ..Options::default()
            });
            let node = SimNode::new(0, &options, now_ns());
            let player = Player::new(session, node, options, Arc::default()).unwrap();
            let refusal = ReportRefusal {
                v: VERSION,
                reason: RefusalReason::Busy,
                detail: "too many batches wait".to_owned(),
                retry_after_ms: Some(MINUTE.as_millis() as u64),
            };
            let json = serde_json::to_vec(&refusal).unwrap();
            let hub = player
                .session
                .declare_queryable(player.keys.report())
                .callback(move |query| query.reply_err(json.clone()).wait().unwrap())
                .await
                .unwrap();
            Self { player, _hub: hub }
        }

        /// Sends a batch and waits until it is refused.
        async fn send(&mut self) {
            self.player.send_batch_of_at_least(12);
            let ended = self.player.requests.join_next().await.unwrap().unwrap();
            self.player.request_ended(ended, Instant::now());
        }

        fn counts(&self) -> Counts {
            *self.player.totals.counts.lock()
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_new_clip_does_not_end_the_pause_after_a_refusal() {
        let mut refused = Refused::new().await;
        refused.send().await;
        let resend_at = refused.player.resend_at;
        assert!(resend_at.is_some());
        refused.player.make_clip();
        assert_eq!(refused.player.resend_at, resend_at);
        let counts = refused.counts();
        assert_eq!(counts.made, 21);
        assert_eq!(counts.batches, 1);
        assert_eq!(counts.busy, 1);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_refused_node_does_not_come_back_before_the_hub_asks_it_to() {
        let mut refused = Refused::new().await;
        // The pauses are random.
        for _ in 0..20 {
            let began = Instant::now();
            refused.player.resend_at = None;
            refused.send().await;
            let resend_at = refused.player.resend_at.unwrap();
            assert!(resend_at >= began + MINUTE);
        }
        assert_eq!(refused.counts().busy, 20);
    }
}
