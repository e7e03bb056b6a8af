//! A camera's loop: takes frames from the ring, drives the policy through each, publishes the answers and
//! counts the open clip. One task per camera; the detector, the screen and the meter are shared.

pub mod answer;
mod at_once;
pub mod audit;
pub mod clip;
mod config;
pub mod evidence;
mod published;
pub(crate) mod publishing;
mod record;
mod settled;

pub(crate) use at_once::AtOnce;
pub use config::{AnswerTime, SettleConfig};
pub use published::ReportConfig;
pub use record::FrameRecord;
pub(crate) use settled::SettledStream;
#[cfg(test)]
pub(crate) use tests::answer;

use crate::camera::answer::{AnswerContext, detections_message};
use crate::camera::at_once::Fetched;
use crate::camera::audit::{CameraAudit, DrawnFrame};
use crate::camera::clip::FrameArrival;
use crate::camera::evidence::{LiveEvidence, Times};
use crate::camera::publishing::Detections;
use crate::camera::settled::FrameLabel;
use crate::delivery::report::ClipAccounts;
use crate::input::RingReceiver;
use crate::input::receiver::{DropCounts, DropKind, SequencedFrame};
use crate::state::board::CameraBoard;
use albireo_core::policy::{
    CallCause, Evidence, EvidenceSource, FrameHead, KnobError, MinConfidence, Need, Outcome,
    Policy, decide,
};
use albireo_service::clock::milliseconds;
use albireo_vision::picture::{EncodedPicture, FrameFault};
use albireo_wire::{DetectionsMessage, Latency, Threshold};
use std::future::Future;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// One camera's loop and all it works with.
pub(crate) struct Camera {
    /// What HTTP and metrics see of it.
    pub board: Arc<CameraBoard>,
    /// Frames from the receiver.
    pub ring: RingReceiver<SequencedFrame>,
    /// Dropped frames, shared with the receiver.
    pub drops: Arc<DropCounts>,
    /// What decides, and from what evidence.
    pub decider: Decider,
    /// Where answers go.
    pub detections: Arc<Detections>,
    /// Where the final answers of pending frames go.
    pub late: Option<Arc<Detections>>,
    /// Where every frame goes once more when its boxes are settled.
    pub settled: Option<SettledStream>,
    /// Which boxes are published.
    pub min_confidence: MinConfidence,
    /// Names of the detector's classes.
    pub class_names: Arc<[String]>,
    /// Where clips are closed and reported.
    pub accounts: ClipAccounts,
    /// Where frames are left that the detector is to examine afterwards.
    pub audit: Arc<CameraAudit>,
    /// Whether a new clip id of the camera makes the policy forget its objects.
    pub reset_at_clip: bool,
}

/// What decides frames, and when it answers.
pub(crate) enum Decider {
    /// When everything about the frame is known.
    WhenKnown {
        /// What decides.
        policy: Box<dyn Policy>,
        /// Where its evidence comes from.
        evidence: Box<LiveEvidence>,
    },
    /// At once, by prediction.
    AtOnce(Box<AtOnce>),
}

impl Decider {
    fn policy(&self) -> &dyn Policy {
        match self {
            Self::WhenKnown { policy, .. } => &**policy,
            Self::AtOnce(at_once) => at_once.policy(),
        }
    }

    fn set_knob(&mut self, value: f64) -> Result<(), KnobError> {
        match self {
            Self::WhenKnown { policy, .. } => policy.set_knob(value),
            Self::AtOnce(at_once) => at_once.set_knob(value),
        }
    }

    fn reset(&mut self) {
        match self {
            Self::WhenKnown { policy, .. } => policy.reset(),
            Self::AtOnce(at_once) => at_once.reset(),
        }
    }
}

/// What the loop remembers from frame to frame.
struct Stream {
    threshold: watch::Receiver<Option<f64>>,
    /// Index of the frame before; none while the policy knows nothing.
    last_index: Option<u64>,
    /// Highest index and newest stream of the camera so far.
    newest: Option<(u64, u64)>,
    /// Index of the stream's first frame; the policy counts from there.
    first_index: u64,
    clip: Option<Arc<str>>,
    outcome: Outcome,
}

/// A frame whose turn has come.
struct BegunFrame {
    incoming: SequencedFrame,
    head: FrameHead,
    clip: Arc<str>,
    threshold: Option<Threshold>,
    /// When it was taken from the ring.
    taken: Instant,
}

/// What a frame's answer took.
#[derive(Default)]
struct Spent {
    times: Times,
    policy: Duration,
    /// The detector was asked although the screen said "empty", too often in a row.
    overruled: bool,
}

impl Spent {
    fn of(evidence: &LiveEvidence, policy: Duration) -> Self {
        Self {
            times: evidence.times(),
            policy,
            overruled: evidence.screen_is_overruled(),
        }
    }
}

/// Which of a frame's answers a message is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Answer {
    /// The only one.
    Final,
    /// A prediction, before the final one.
    Pending,
    /// The final one after a prediction.
    Late,
}

impl Camera {
    /// Runs until `shutdown` or until the ring closes; finishes the current or pending frame, and closes the open
    /// clip.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        let mut stream = Stream {
            threshold: self.board.watch_threshold(),
            last_index: None,
            newest: None,
            first_index: 0,
            clip: None,
            outcome: Outcome::default(),
        };
        stream.threshold.mark_changed();
        loop {
            let settled = self.settled.as_ref().and_then(SettledStream::deadline);
            let due = self.accounts.deadline().into_iter().chain(settled).min();
            tokio::select! {
                biased;
                () = shutdown.cancelled() => break,
                fetched = fetched(&mut self.decider) => self.deliver(fetched, &mut stream.outcome).await,
                // Before the clock: a camera whose frames wait is not silent, only the detector is slow.
                incoming = self.ring.next() => match incoming {
                    Some(incoming) => self.process(incoming, &mut stream).await,
                    None => break,
                },
                () = at(due) => self.tick().await,
            }
        }
        while self.is_pending() {
            let fetched = fetched(&mut self.decider).await;
            self.deliver(fetched, &mut stream.outcome).await;
        }
        if let Some(settled) = &mut self.settled {
            settled.flush();
            settled.publish().await;
        }
        self.end();
    }

    fn is_pending(&self) -> bool {
        matches!(&self.decider, Decider::AtOnce(at_once) if at_once.is_pending())
    }

    async fn tick(&mut self) {
        if self
            .accounts
            .deadline()
            .is_some_and(|due| due <= Instant::now())
        {
            self.accounts.tick();
        }
        if let Some(settled) = &mut self.settled {
            settled.tick();
            settled.publish().await;
        }
    }

    /// Takes no more frames, counts those that wait, and ends the open clip. The second time there is nothing to do.
    fn end(&mut self) {
        for mut frame in self.ring.close_and_clear() {
            let reason = "the camera's loop ended before its turn";
            self.drops.count(DropKind::Stopped, 1, &reason);
            frame.refuse(reason);
        }
        self.audit.give_up();
        self.accounts.shutdown();
    }

    async fn process(&mut self, incoming: SequencedFrame, stream: &mut Stream) {
        let Some(frame) = self.begin(incoming, stream).await else {
            return;
        };
        let outcome = &mut stream.outcome;
        match &mut self.decider {
            Decider::WhenKnown { policy, evidence } => {
                evidence.next_frame();
                let mut source = FrameSource {
                    evidence,
                    ring: &self.ring,
                    incoming: &frame.incoming,
                    head: frame.head,
                };
                let deciding = Instant::now();
                let decided = decide(&mut **policy, frame.head, &mut source, outcome).await;
                let deciding = deciding.elapsed();
                evidence.end_frame();
                if let Err(fault) = decided {
                    return self.drops.count(DropKind::from(&fault), 1, &fault);
                }
                let spent = Spent::of(evidence, deciding.saturating_sub(evidence.times().evidence));
                let message = self.answer(&frame, outcome, &spent, Answer::Final).await;
                let record = FrameRecord::new(message, frame.incoming.frame.received.elapsed());
                let record = record.examined(&spent.times);
                self.count(&record, &frame, outcome, Answer::Final);
            }
            Decider::AtOnce(at_once) => {
                let deciding = Instant::now();
                let need = at_once.frame(frame.head, outcome);
                let spent = Spent {
                    policy: deciding.elapsed(),
                    ..Spent::default()
                };
                let answer = match need {
                    Need::Nothing => Answer::Final,
                    _ => Answer::Pending,
                };
                let message = self.answer(&frame, outcome, &spent, answer).await;
                let first_answer = frame.incoming.frame.received.elapsed();
                if answer == Answer::Final {
                    let record = FrameRecord::new(message, first_answer);
                    self.count(&record, &frame, outcome, answer);
                } else if let Decider::AtOnce(at_once) = &mut self.decider {
                    self.accounts.pending(message.seq, frame.threshold);
                    at_once.fetch(frame, need, first_answer);
                }
            }
        }
    }

    /// Takes what was fetched for the pending frame; if nothing more is needed, its answer is final.
    async fn deliver(&mut self, fetched: Fetched, outcome: &mut Outcome) {
        if let Decider::AtOnce(at_once) = &mut self.decider
            && let Some(done) = at_once.deliver(fetched, outcome)
        {
            self.finish(done, outcome).await;
        }
    }

    /// The pending frame, if there is one, gets no evidence: its answer is what the policy predicts.
    async fn give_up_pending(&mut self, outcome: &mut Outcome) {
        if let Decider::AtOnce(at_once) = &mut self.decider
            && let Some(done) = at_once.give_up(outcome)
        {
            self.finish(done, outcome).await;
        }
    }

    /// Publishes and counts the final answer of a frame that was pending.
    async fn finish(&mut self, done: at_once::Answered, outcome: &mut Outcome) {
        let at_once::Answered { pending, spent } = done;
        let message = self
            .answer(&pending.frame, outcome, &spent, Answer::Late)
            .await;
        let record = FrameRecord::new(message, pending.first_answer).examined(&spent.times);
        self.count(&record, &pending.frame, outcome, Answer::Late);
    }

    /// Prepares for a frame: its place in the stream, the threshold in force, its clip. `None` for one that was overtaken.
    async fn begin(&mut self, incoming: SequencedFrame, stream: &mut Stream) -> Option<BegunFrame> {
        let taken = Instant::now();
        let frame = &incoming.frame;
        if stream
            .newest
            .is_some_and(|(index, _)| incoming.index <= index)
        {
            let sequence = frame.sequence;
            let reason = format_args!("sequence number {sequence} was overtaken on its way");
            self.drops.count(DropKind::Late, 1, &reason);
            return None;
        }
        let restarted = stream
            .newest
            .replace((incoming.index, incoming.epoch))
            .is_some_and(|(_, epoch)| epoch != incoming.epoch);
        let new_clip = frame.clip.is_some() && frame.clip != stream.clip;
        if restarted || (new_clip && self.reset_at_clip && stream.clip.is_some()) {
            self.give_up_pending(&mut stream.outcome).await;
            self.decider.reset();
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
        let knob = self.board.knob().zip(self.decider.policy().knob_value());
        Some(BegunFrame {
            head,
            clip,
            threshold: knob.map(|(knob, value)| Threshold::new(knob.name, value)),
            taken,
            incoming,
        })
    }

    /// Publishes an answer of a frame. Of the boxes in `outcome` those stay that are published.
    async fn answer(
        &mut self,
        frame: &BegunFrame,
        outcome: &mut Outcome,
        spent: &Spent,
        answer: Answer,
    ) -> Arc<DetectionsMessage> {
        // The policy sees that the scene is not empty; only this loop knows that the screen was overruled.
        if outcome.cause == Some(CallCause::Screen) && spent.overruled {
            outcome.cause = Some(CallCause::EmptyLimit);
        }
        let BegunFrame { incoming, .. } = frame;
        let received = incoming.frame.received;
        if let Some(settled) = &mut self.settled {
            let label = FrameLabel {
                seq: incoming.frame.sequence,
                t_ns: incoming.frame.time_ns,
                clip: Arc::clone(&frame.clip),
                picture: frame.head.picture,
            };
            match answer {
                Answer::Late => settled.late(incoming.index, outcome),
                _ => settled.frame(incoming.index, label, outcome, answer == Answer::Pending),
            }
        }
        self.min_confidence.select(&mut outcome.boxes);
        let Spent { times, policy, .. } = spent;
        let message = Arc::new(detections_message(
            outcome,
            &AnswerContext {
                frame: &incoming.frame,
                clip: &frame.clip,
                pending: answer == Answer::Pending,
                threshold: frame.threshold,
                class_names: &self.class_names,
                latency: Latency {
                    total: milliseconds(received.elapsed()),
                    waiting: milliseconds(frame.taken - received),
                    decode: times.decode.map(milliseconds),
                    screen: times.screen.map(milliseconds),
                    detector: times.detector().map(milliseconds),
                    policy: milliseconds(*policy),
                },
            },
        ));
        let publisher = match answer {
            Answer::Late => self.late.as_ref(),
            _ => Some(&self.detections),
        };
        match (serde_json::to_vec(&*message), publisher) {
            (Ok(json), Some(publisher)) => publisher.publish(json).await,
            (Ok(_), None) => {}
            (Err(error), _) => {
                tracing::error!(camera = self.board.name(), %error, "detections not written");
            }
        }
        if let Some(settled) = &mut self.settled {
            settled.publish().await;
        }
        match answer {
            Answer::Late => self.board.show_late(Arc::clone(&message)),
            _ => self.board.show(Arc::clone(&message)),
        }
        message
    }

    /// Counts a frame whose answer is final, and leaves it to the audit if it is drawn.
    fn count(
        &mut self,
        record: &FrameRecord,
        frame: &BegunFrame,
        outcome: &Outcome,
        answer: Answer,
    ) {
        match answer {
            Answer::Late => self.accounts.count_late(record),
            _ => self.accounts.count(record),
        }
        self.board.record_frame(record);
        let skipped = outcome.state.is_skipped() && !outcome.degraded;
        if skipped && self.audit.draws(frame.incoming.index) {
            self.audit.offer(DrawnFrame {
                picture: frame.incoming.frame.picture.clone(),
                shown: outcome.boxes.clone(),
            });
        }
    }

    /// Takes a changed threshold over, so that it holds from this frame on.
    fn turn_knob(&mut self, threshold: &mut watch::Receiver<Option<f64>>) {
        if !threshold.has_changed().unwrap_or(false) {
            return;
        }
        if let Some(value) = *threshold.borrow_and_update()
            && let Err(error) = self.decider.set_knob(value)
        {
            tracing::error!(camera = self.board.name(), %error, "threshold not taken by the policy");
        }
    }
}

/// What was fetched for the pending frame, when it comes; for ever where none is pending.
async fn fetched(decider: &mut Decider) -> Fetched {
    match decider {
        Decider::AtOnce(at_once) => at_once.fetched().await,
        Decider::WhenKnown { .. } => std::future::pending().await,
    }
}

/// One frame's evidence, and a preview of the next frame.
struct FrameSource<'a> {
    evidence: &'a mut LiveEvidence,
    ring: &'a RingReceiver<SequencedFrame>,
    incoming: &'a SequencedFrame,
    head: FrameHead,
}

impl EvidenceSource for FrameSource<'_> {
    type Error = FrameFault;

    async fn evidence(
        &mut self,
        need: Need,
        policy: &dyn Policy,
    ) -> Result<Evidence<'_>, FrameFault> {
        let next = || next_need(self.ring, self.incoming, policy, self.head);
        let picture = &self.incoming.frame.picture;
        self.evidence.evidence(need, picture, next).await
    }
}

/// Also where the loop panicked or was given up: what was counted until then is reported.
impl Drop for Camera {
    fn drop(&mut self) {
        // What panicked may be what is asked here; a second panic must not end the process.
        if catch_unwind(AssertUnwindSafe(|| self.end())).is_err() {
            tracing::error!(camera = self.board.name(), "the open clip is lost");
        }
    }
}

/// The picture of the frame after `present` and what it will need, once it waits in the ring; for ever, when it
/// may need nothing or there is another frame than the one foreseen. A predicted frame is never decoded.
fn next_need(
    ring: &RingReceiver<SequencedFrame>,
    present: &SequencedFrame,
    policy: &dyn Policy,
    head: FrameHead,
) -> impl Future<Output = (EncodedPicture, Need)> + Send {
    let need = policy.foresee(FrameHead {
        index: head.index.saturating_add(1),
        step: 1,
        ..head
    });
    async move {
        if need != Need::Nothing {
            let follows = |next: &SequencedFrame| {
                let foreseen = next.epoch == present.epoch
                    && next.index.checked_sub(present.index) == Some(1)
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

/// Waits until `due`; for ever without one.
async fn at(due: Option<Instant>) {
    match due {
        Some(due) => tokio::time::sleep_until(due).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests;
