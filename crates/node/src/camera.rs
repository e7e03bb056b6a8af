//! A camera's loop: takes frames from the ring, drives the policy through each, publishes the answer and
//! keeps the clip's books. One task a camera; the detector, the screen and the meter are shared.

use super::answer::{AnswerContext, detections_message};
use super::board::CameraBoard;
use super::evidence::LiveEvidence;
use super::intake::{DropCounts, DropKind, Incoming};
use super::report::ClipAccounts;
use crate::clip::{FrameArrival, FrameResult};
use crate::frame::{EncodedPicture, FrameFault, RingReceiver};
use crate::publishing::Detections;
use albireo_core::policy::{Evidence, FrameHead, GreyPicture, Need, Outcome, Policy};
use albireo_wire::{KnobValue, Latency};
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// One camera's loop and all it works with.
pub(crate) struct Camera {
    /// What HTTP and metrics see of it.
    pub board: Arc<CameraBoard>,
    /// Frames from the intake.
    pub ring: RingReceiver<Incoming>,
    /// Dropped frames, shared with the intake.
    pub ledger: Arc<DropCounts>,
    /// What decides.
    pub policy: Box<dyn Policy>,
    /// Where its evidence comes from.
    pub evidence: LiveEvidence,
    /// Where detections go.
    pub detections: Detections,
    /// Names of the detector's classes.
    pub class_names: Arc<[String]>,
    /// Where clips are closed and reported.
    pub accounts: ClipAccounts,
    /// Whether a new clip id of the camera makes the policy forget its objects.
    pub reset_at_clip: bool,
}

/// What the loop remembers from frame to frame.
struct Stream {
    threshold: watch::Receiver<Option<f64>>,
    last_index: Option<u64>,
    /// Index of the stream's first frame; the policy counts from there.
    first_index: u64,
    clip: Option<Arc<str>>,
    outcome: Outcome,
}

impl Camera {
    /// Runs until `shutdown` or until the ring closes; finishes the frame in hand and closes the open
    /// clip.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        let mut stream = Stream {
            threshold: self.board.watch_threshold(),
            last_index: None,
            first_index: 0,
            clip: None,
            outcome: Outcome::default(),
        };
        stream.threshold.mark_changed();
        loop {
            let due = self.accounts.deadline();
            tokio::select! {
                biased;
                () = shutdown.cancelled() => break,
                () = at(due) => self.accounts.tick(),
                incoming = self.ring.next() => match incoming {
                    Some(incoming) => self.process(incoming, &mut stream).await,
                    None => break,
                },
            }
        }
        self.ring.close();
        self.accounts.shutdown();
    }

    async fn process(&mut self, incoming: Incoming, stream: &mut Stream) {
        let taken = Instant::now();
        let frame = &incoming.frame;
        let new_clip = frame.clip.is_some() && frame.clip != stream.clip;
        if incoming.restarted || (new_clip && self.reset_at_clip && stream.clip.is_some()) {
            self.policy.reset();
            stream.last_index = None;
        }
        stream.clip.clone_from(&frame.clip);
        self.turn_knob(&mut stream.threshold);

        let step = match stream.last_index.replace(incoming.index) {
            Some(last) => incoming.index.saturating_sub(last).max(1),
            None => {
                stream.first_index = incoming.index;
                1
            }
        };
        let head = FrameHead {
            index: incoming.index - stream.first_index,
            step: u32::try_from(step).unwrap_or(u32::MAX),
            picture: frame.picture.size,
        };
        let clip = self.accounts.arrive(&FrameArrival {
            t_ns: frame.time_ns,
            clip: frame.clip.as_deref(),
            arrival: frame.received,
        });
        self.evidence.next_frame();
        let deciding = match self.decide(&incoming, head).await {
            Ok(deciding) => deciding,
            Err(fault) => {
                return self.ledger.count(DropKind::from(&fault), 1, &fault);
            }
        };
        let finishing = Instant::now();
        self.policy.finish(&mut stream.outcome);
        let policy_time = deciding + finishing.elapsed();

        let times = self.evidence.times;
        let message = detections_message(
            &stream.outcome,
            &AnswerContext {
                frame,
                clip: &clip,
                knob: self
                    .board
                    .knob()
                    .zip(self.policy.knob_value())
                    .map(|(knob, value)| KnobValue::new(&knob, value)),
                class_names: &self.class_names,
                latency: Latency {
                    total: milliseconds(frame.received.elapsed()),
                    waiting: milliseconds(taken - frame.received),
                    decode: times.decode.map(milliseconds),
                    screen: times.screen.map(milliseconds),
                    detector: times.detector().map(milliseconds),
                    policy: milliseconds(policy_time),
                },
            },
        );
        match serde_json::to_vec(&message) {
            Ok(json) => {
                self.detections.publish(json).await;
            }
            Err(error) => {
                tracing::error!(camera = self.board.name(), %error, "detections not written");
            }
        }
        if let Some((start, end)) = times.detector_span {
            self.accounts.detector_ran(start, end);
        }
        self.accounts.count(&FrameResult {
            seq: frame.sequence,
            state: message.state,
            degraded: message.degraded,
            total: frame.received.elapsed(),
            detector: times.detector(),
            knob: message.knob,
        });
        self.board.record_screen(self.evidence.screen_counts());
        self.board.record_frame(Arc::new(message));
    }

    /// Takes a changed threshold over, so that it holds from this frame on.
    fn turn_knob(&mut self, threshold: &mut watch::Receiver<Option<f64>>) {
        if !threshold.has_changed().unwrap_or(false) {
            return;
        }
        if let Some(value) = *threshold.borrow_and_update()
            && let Err(error) = self.policy.set_knob(value)
        {
            tracing::error!(camera = self.board.name(), %error, "threshold not taken by the policy");
        }
    }

    /// Asks and answers until the policy needs nothing more; the time the policy itself took.
    async fn decide(
        &mut self,
        incoming: &Incoming,
        head: FrameHead,
    ) -> Result<Duration, FrameFault> {
        let picture = &incoming.frame.picture;
        let mut policy_time = Duration::ZERO;
        let mut timed = |start: Instant| policy_time += start.elapsed();
        let start = Instant::now();
        let mut need = self.policy.begin(head);
        timed(start);
        while need != Need::Nothing {
            let detected;
            let evidence = match need {
                Need::Nothing => break,
                Need::Screen => match self.evidence.screen(picture).await? {
                    Some(empty) => Evidence::Screen { empty },
                    None => Evidence::Unavailable,
                },
                Need::GreyPicture => {
                    let grey = self.evidence.grey(picture).await?;
                    Evidence::GreyPicture(GreyPicture {
                        size: grey.size,
                        pixels: &grey.pixels,
                    })
                }
                Need::Detections => {
                    let next = next_need(&self.ring, incoming, &*self.policy, head);
                    detected = self.evidence.detect(picture, next).await?;
                    match &detected {
                        Some(detected) => Evidence::Detections(&detected.detections),
                        None => Evidence::Unavailable,
                    }
                }
            };
            let start = Instant::now();
            need = self.policy.answer(evidence);
            timed(start);
        }
        Ok(policy_time)
    }
}

/// The picture of the frame after `present` and what it will need, once it waits in the ring; for ever, when it
/// may need nothing or there is another frame than the one foreseen. A predicted frame is never decoded.
fn next_need(
    ring: &RingReceiver<Incoming>,
    present: &Incoming,
    policy: &dyn Policy,
    head: FrameHead,
) -> impl Future<Output = (EncodedPicture, Need)> + Send {
    let need = policy.foresee(FrameHead {
        index: head.index + 1,
        step: 1,
        ..head
    });
    async move {
        if need != Need::Nothing {
            let follows = |next: &Incoming| {
                let foreseen = !next.restarted
                    && next.index == present.index + 1
                    && next.frame.clip == present.frame.clip
                    && next.frame.picture.size == present.frame.picture.size;
                foreseen.then(|| next.frame.picture.clone())
            };
            if let Some(Some(picture)) = ring.peek(follows).await {
                return (picture, need);
            }
        }
        std::future::pending().await
    }
}

fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Waits until `due`; for ever without one.
async fn at(due: Option<Instant>) {
    match due {
        Some(due) => tokio::time::sleep_until(due).await,
        None => std::future::pending().await,
    }
}
