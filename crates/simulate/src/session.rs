//! One Zenoh session and the nodes that talk through it.

use super::error::SimulateError;
use super::node::{SimNode, mix, unit};
use super::options::Options;
use super::totals::{Totals, count};
use albireo_wire::{
    ConfigChanged, Desired, FleetKeys, PullRequest, RefusalReason, ReportAnswer, ReportRefusal,
    VERSION,
};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;

/// How long an answer to a batch or a pull is awaited.
const ANSWER_WITHIN: Duration = Duration::from_secs(10);
/// First and longest pause after a batch that was not acknowledged.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// Things heard that may wait to be handled by the session's task.
const HEARD: usize = 4096;
/// Most reports of a batch.
const MOST_REPORTS: u64 = 90;
/// First part of every key.
const PREFIX: &str = "albireo";

/// What is done for a node at a time of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Due {
    Status,
    /// A status beside the period's.
    StatusNow,
    Clip,
    Send,
}

/// What came for a node.
enum Message {
    ConfigChanged(usize),
    Desired(usize, Desired),
    /// So many reports, and what else was answered.
    Acknowledged(usize, u64, ReportAnswer, Duration),
    /// Not acknowledged; when to try again, if the hub said so.
    Refused(usize, Option<RefusalReason>, Option<Duration>),
}

/// Within this time all nodes send their first status.
const FIRST_STATUSES: Duration = Duration::from_secs(5);

/// So long after the beginning the flood that all nodes make by beginning at once is over.
pub(crate) const SETTLED: Duration = Duration::from_secs(20);

struct Place {
    node: SimNode,
    keys: FleetKeys,
    /// A batch is under way.
    sending: bool,
    pause: Duration,
}

/// A session with its nodes, ready to play.
pub(crate) struct Player {
    session: Session,
    places: Vec<Place>,
    options: Arc<Options>,
    totals: Arc<Totals>,
    due: BinaryHeap<Reverse<(Instant, usize, Due)>>,
    message: mpsc::Receiver<Message>,
    sender: mpsc::Sender<Message>,
    /// No more clips are made: what is left is sent, however little.
    ending: bool,
    /// From when on nothing is left of everybody's beginning at once.
    settled: Instant,
    _notices: Vec<Subscriber<()>>,
}

/// Opens a client session to the endpoint, with the buffers of a node's uplink.
pub(crate) async fn open(options: &Options, index: usize) -> Result<Session, SimulateError> {
    let mut config = match &options.zenoh_config {
        Some(file) => zenoh::Config::from_file(file)
            .map_err(|error| SimulateError::zenoh(file.display().to_string(), error))?,
        None => zenoh::Config::default(),
    };
    // Thousands that lost their router come back spread out.
    let first_retry = 500 + mix(options.seed, index as u64) % 2_000;
    let retry = serde_json::json!({"period_init_ms": first_retry, "period_max_ms": 5_000, "period_increase_factor": 2});
    for (key, value) in [
        ("mode", serde_json::json!("client")),
        ("connect/endpoints", serde_json::json!([options.connect])),
        ("connect/timeout_ms", serde_json::json!(-1)),
        ("connect/exit_on_failure", serde_json::json!(false)),
        ("connect/retry", retry),
        ("listen/endpoints", serde_json::json!([])),
        ("scouting/multicast/enabled", serde_json::json!(false)),
        ("scouting/gossip/enabled", serde_json::json!(false)),
        // As a node's uplink.
        ("transport/shared_memory/enabled", serde_json::json!(false)),
        ("transport/link/tx/lease", serde_json::json!(120_000)),
        ("transport/link/tx/batch_size", serde_json::json!(8_192)),
        ("transport/link/rx/buffer_size", serde_json::json!(8_192)),
    ] {
        config
            .insert_json5(key, &value.to_string())
            .map_err(|error| SimulateError::zenoh(key, error))?;
    }
    zenoh::open(config)
        .await
        .map_err(|error| SimulateError::zenoh(format!("session {index}"), error))
}

pub(crate) fn now_ns() -> u64 {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

impl Player {
    /// Declares what the nodes of the session need.
    pub(crate) async fn new(
        session: Session,
        nodes: Vec<SimNode>,
        options: Arc<Options>,
        totals: Arc<Totals>,
    ) -> Result<Self, SimulateError> {
        let (sender, message) = mpsc::channel(HEARD);
        let (mut places, mut notices) = (Vec::new(), Vec::new());
        for (index, node) in nodes.into_iter().enumerate() {
            let keys = FleetKeys::new(PREFIX, &node.name)?;
            if options.notices {
                let sender = sender.clone();
                let notified = session
                    .declare_subscriber(keys.changed())
                    .callback(move |sample| {
                        if albireo_wire::read::<ConfigChanged>(&sample.payload().to_bytes()).is_ok()
                        {
                            // Too many at once: the answer to the next report has the same.
                            let _ = sender.try_send(Message::ConfigChanged(index));
                        }
                    });
                notices.push(notified.await.map_err(|error| {
                    SimulateError::zenoh(format!("notice of {}", node.name), error)
                })?);
            }
            places.push(Place {
                node,
                keys,
                sending: false,
                pause: FIRST_PAUSE,
            });
        }
        Ok(Self {
            session,
            places,
            options,
            totals,
            due: BinaryHeap::new(),
            message,
            sender,
            ending: false,
            settled: Instant::now(),
            _notices: notices,
        })
    }

    /// Plays until `end`; then sends what is left until `stop`. Returns the reports made and acknowledged by its nodes.
    pub(crate) async fn play(
        mut self,
        began: Instant,
        end: CancellationToken,
        stop: CancellationToken,
    ) -> (u64, u64) {
        self.settled = began + SETTLED;
        let status = Duration::from_secs_f64(self.options.status_s);
        let clip = Duration::from_secs_f64(self.options.clip_s);
        for index in 0..self.places.len() {
            // Everybody's times are spread over the period.
            let name = self.salt(index);
            let spread = |period: Duration, salt| period.mul_f64(unit(mix(name, salt)));
            self.due.push(Reverse((
                began + spread(status.min(FIRST_STATUSES), 1),
                index,
                Due::Status,
            )));
            self.due
                .push(Reverse((began + spread(clip, 2), index, Due::Clip)));
            self.pull(index);
        }
        loop {
            if self.ending && self.places.iter().all(|place| place.node.waiting() == 0) {
                break;
            }
            let next = self.due.peek().map(|Reverse((at, ..))| *at);
            let next = next.unwrap_or_else(|| Instant::now() + status);
            tokio::select! {
                message = self.message.recv() => match message {
                    Some(message) => self.handle(message),
                    None => break,
                },
                () = tokio::time::sleep_until(next) => {
                    let Some(Reverse((at, index, due))) = self.due.pop() else { continue };
                    match due {
                        Due::Status if !self.ending => {
                            // All are known soon; from then on their times are spread over the whole period.
                            let period = if at < began + FIRST_STATUSES {
                                status.mul_f64(unit(mix(self.salt(index), 3)))
                            } else {
                                status
                            };
                            self.due.push(Reverse((at + period.max(FIRST_STATUSES.min(status)), index, Due::Status)));
                            self.status(index).await;
                        }
                        Due::StatusNow if !self.ending => self.status(index).await,
                        Due::Clip if !self.ending => {
                            self.due.push(Reverse((at + clip, index, Due::Clip)));
                            self.places[index].node.made += 1;
                            count(&self.totals.made, 1);
                            if self.places[index].node.waiting() >= self.options.gather { self.send(index) }
                        }
                        Due::Send => self.send(index),
                        Due::Status | Due::StatusNow | Due::Clip => {}
                    }
                }
                () = end.cancelled(), if !self.ending => {
                    self.ending = true;
                    for index in 0..self.places.len() { self.send(index) }
                }
                () = stop.cancelled() => break,
            }
        }
        let sums = self
            .places
            .iter()
            .fold((0, 0), |(made, acknowledged), place| {
                (
                    made + place.node.made,
                    acknowledged + place.node.acknowledged,
                )
            });
        if let Err(error) = self.session.close().await {
            tracing::debug!(%error, "session not closed");
        }
        sums
    }

    /// A number of that node's own.
    fn salt(&self, index: usize) -> u64 {
        let name = self.places[index].node.name.bytes();
        name.fold(self.options.seed, |seed, byte| mix(seed, byte.into()))
    }

    fn handle(&mut self, message: Message) {
        match message {
            Message::ConfigChanged(index) => self.pull(index),
            Message::Desired(index, desired) => self.take(index, &desired),
            Message::Acknowledged(index, reports, answer, took) => {
                self.totals.answers.add(took);
                if !self.ending && self.settled <= Instant::now() {
                    self.totals.settled.add(took);
                }
                let place = &mut self.places[index];
                place.sending = false;
                place.pause = FIRST_PAUSE;
                place.node.answered(reports);
                count(&self.totals.acknowledged, reports);
                if place.node.waiting() >= self.options.gather
                    || (self.ending && place.node.waiting() > 0)
                {
                    self.send(index);
                }
                if let Some(desired) = answer.desired {
                    self.take(index, &desired);
                }
            }
            Message::Refused(index, reason, after) => {
                let counter = match reason {
                    Some(RefusalReason::Busy) => &self.totals.busy,
                    Some(_) => &self.totals.refused,
                    None => &self.totals.no_reply,
                };
                count(counter, 1);
                self.later(index, after);
            }
        }
    }

    /// A batch was not acknowledged: again after a pause that grows.
    fn later(&mut self, index: usize, after: Option<Duration>) {
        let place = &mut self.places[index];
        place.sending = false;
        let pause = after.unwrap_or(place.pause).max(place.pause);
        let spread = unit(mix(place.node.made, now_ns()));
        place.pause = (place.pause * 2).min(LONGEST_PAUSE);
        let at = Instant::now() + pause.mul_f64(0.5 + spread);
        self.due.push(Reverse((at, index, Due::Send)));
    }

    fn take(&mut self, index: usize, desired: &Desired) {
        if self.places[index].node.take(desired) {
            // A change is reported at once.
            self.due
                .push(Reverse((Instant::now(), index, Due::StatusNow)));
        }
    }

    async fn status(&mut self, index: usize) {
        let place = &mut self.places[index];
        let Ok(payload) = place.node.status_payload(now_ns()) else {
            return;
        };
        let put = self
            .session
            .put(place.keys.status(), payload)
            .encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Drop);
        match put.await {
            Ok(()) => count(&self.totals.statuses, 1),
            Err(error) => tracing::debug!(%error, "status not sent"),
        }
    }

    fn send(&mut self, index: usize) {
        let place = &mut self.places[index];
        if place.sending || place.node.waiting() == 0 {
            return;
        }
        let Some(batch) = place.node.batch(MOST_REPORTS, now_ns()) else {
            return;
        };
        place.sending = true;
        let (session, key, sender) = (
            self.session.clone(),
            place.keys.report(),
            self.sender.clone(),
        );
        let totals = Arc::clone(&self.totals);
        tokio::spawn(async move {
            let began = Instant::now();
            let message = match report(&session, key, &batch, &totals).await {
                Some(Ok(answer)) => {
                    let reports = batch.reports.len() as u64;
                    Message::Acknowledged(index, reports, answer, began.elapsed())
                }
                Some(Err(refusal)) => Message::Refused(
                    index,
                    Some(refusal.reason),
                    refusal.retry_after_ms.map(Duration::from_millis),
                ),
                None => Message::Refused(index, None, None),
            };
            // Closed when the run is over.
            let _ = sender.send(message).await;
        });
    }

    fn pull(&self, index: usize) {
        let place = &self.places[index];
        let request = PullRequest {
            v: VERSION,
            revision: place.node.revision(),
        };
        let Ok(payload) = serde_json::to_vec(&request) else {
            return;
        };
        let (session, key, sender) = (self.session.clone(), place.keys.pull(), self.sender.clone());
        count(&self.totals.pulls, 1);
        tokio::spawn(async move {
            if let Some(Ok(answer)) = ask(&session, key, payload, Encoding::APPLICATION_JSON).await
                && let Ok(desired) = albireo_wire::read::<Desired>(&answer)
            {
                let _ = sender.send(Message::Desired(index, desired)).await;
            }
        });
    }
}

/// Sends a batch; `None` when nobody answered.
async fn report(
    session: &Session,
    key: String,
    batch: &albireo_wire::ReportBatch,
    totals: &Totals,
) -> Option<Result<ReportAnswer, ReportRefusal>> {
    // What a batch costs its sender is multiplied by all the nodes that are played here.
    let payload = batch
        .to_payload(albireo_wire::BatchCompression::Quick)
        .ok()?;
    count(&totals.batches, 1);
    count(&totals.bytes, payload.len() as u64);
    let answer = ask(session, key, payload, Encoding::APPLICATION_JSON).await?;
    let bytes = match &answer {
        Ok(bytes) | Err(bytes) => bytes,
    };
    if let (Ok(_), Ok(answer)) = (&answer, albireo_wire::read::<ReportAnswer>(bytes)) {
        return Some(Ok(answer));
    }
    Some(Err(albireo_wire::read::<ReportRefusal>(bytes).ok()?))
}

/// A query with a payload and its first answer: good or error.
async fn ask(
    session: &Session,
    key: String,
    payload: Vec<u8>,
    encoding: Encoding,
) -> Option<Result<Vec<u8>, Vec<u8>>> {
    let replies = session
        .get(key)
        .payload(payload)
        .encoding(encoding)
        .congestion_control(CongestionControl::Drop)
        .timeout(ANSWER_WITHIN)
        .await
        .ok()?;
    let reply = replies.recv_async().await.ok()?;
    Some(match reply.result() {
        Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
        Err(error) => Err(error.payload().to_bytes().into_owned()),
    })
}
