//! A camera's loop: takes frames from the ring, drives the policy through each, publishes the answers and
//! counts the open clip. One task per camera; the detector, the screen and the meter are shared.

pub mod answer;
pub mod audit;
pub mod clip;
mod config;
mod decider;
pub mod evidence;
pub(crate) mod publishing;
mod settled;

pub use config::{AnswerTime, ReportConfig, SettleConfig};
pub(crate) use decider::Decider;
pub(crate) use settled::SettledStream;
#[cfg(test)]
pub(crate) use tests::answer;

use crate::camera::answer::detections_message;
use crate::camera::audit::{CameraAudit, DrawnFrame};
use crate::camera::clip::{Clip, ClipTracker};
use crate::camera::decider::{Decided, Fetched};
use crate::camera::evidence::Times;
use crate::camera::publishing::Outlet;
use crate::input::receiver::{FrameReceiver, SequencedFrame, kind_of};
use crate::state::board::CameraBoard;
use albireo_core::policy::{CallCause, FrameHead, MinConfidence, Need, Outcome};
use albireo_power::CameraEnergy;
use albireo_service::clock::milliseconds;
use albireo_wire::{DetectionsMessage, Latency, Threshold};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// These parts of a camera stay when its loop is started again.
pub(crate) struct CameraParts {
    /// It shows the camera to HTTP and metrics.
    pub board: Arc<CameraBoard>,
    /// Its frames come from there.
    pub receiver: Arc<FrameReceiver>,
    /// Answers go there.
    pub detections: Outlet,
    /// The final answers of pending frames go there, if frames are answered at once.
    pub late: Option<Outlet>,
    /// Every frame goes there once more when its boxes are settled.
    pub settled: Option<Arc<Outlet>>,
    /// It selects the boxes that are published.
    pub min_confidence: MinConfidence,
    /// Names of the detector's classes.
    pub class_names: Arc<[String]>,
    /// Clips that have ended go there. It is unbounded, because a clip is some kilobytes every some seconds and must not be
    /// lost. Their reporter's own waiting is bounded.
    pub closed: mpsc::UnboundedSender<Clip>,
    /// Frames that the detector is to examine afterwards are left there.
    pub audit: Arc<CameraAudit>,
    /// The camera's part of the node's energy.
    pub energy: CameraEnergy,
    /// It is true if a new clip id of the camera makes the policy forget its objects.
    pub reset_at_clip: bool,
}

impl CameraParts {
    fn hand_over(&self, closed: Option<Clip>) {
        if let Some(closed) = closed
            && self.closed.send(closed).is_err()
        {
            tracing::error!("a clip ended and its reporter has stopped");
        }
    }
}

/// One camera's loop.
pub(crate) struct Camera {
    parts: Arc<CameraParts>,
    /// It decides frames.
    decider: Decider,
    /// The frames that are held back until their boxes are settled.
    settled: Option<SettledStream>,
    /// The open clip.
    tracker: ClipTracker,
    threshold: watch::Receiver<Option<f64>>,
    /// Highest index and newest stream of the camera so far.
    newest: Option<(u64, u64)>,
    /// Index of the first frame that the policy knows of, and counts from.
    first_index: Option<u64>,
    /// The camera's name for the clip of the frame before.
    clip: Option<Arc<str>>,
    outcome: Outcome,
}

/// A frame whose turn has come.
struct BegunFrame {
    incoming: SequencedFrame,
    head: FrameHead,
    clip: Arc<str>,
    threshold: Option<Threshold>,
    /// It was taken from the ring at this time.
    taken: Instant,
    /// From its reception to its prediction, if that has been published before the final answer.
    first_answer: Option<Duration>,
    /// The time that its answer has taken so far.
    times: Times,
}

/// A frame with its final answer: given once to everything that counts frames.
#[derive(Clone, Debug)]
pub struct FrameRecord {
    /// The final answer, as published.
    pub detections: Arc<DetectionsMessage>,
    /// It was published at this time.
    pub answered: Instant,
    /// From reception to the first answer, which may have been pending.
    pub first_answer: Duration,
    /// The time that the final answer took.
    pub(crate) times: Times,
}

impl FrameRecord {
    /// A frame that neither detector nor flow examined, answered now and `first_answer` after its reception.
    pub fn new(detections: Arc<DetectionsMessage>, first_answer: Duration) -> Self {
        Self {
            detections,
            answered: Instant::now(),
            first_answer,
            times: Times::default(),
        }
    }
}

impl Camera {
    /// A loop that knows of no frame yet.
    pub(crate) fn new(
        parts: Arc<CameraParts>,
        decider: Decider,
        settled: Option<SettledStream>,
        tracker: ClipTracker,
    ) -> Self {
        let mut threshold = parts.board.watch_threshold();
        threshold.mark_changed();
        Self {
            parts,
            decider,
            settled,
            tracker,
            threshold,
            newest: None,
            first_index: None,
            clip: None,
            outcome: Outcome::default(),
        }
    }

    /// Runs until `shutdown`; finishes the current or pending frame, and closes the open clip.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        loop {
            let settled = self.settled.as_ref().and_then(SettledStream::deadline);
            let due = self.tracker.deadline().into_iter().chain(settled).min();
            // Where a frame is answered when everything is known, those after it wait.
            let waits = self.decider.is_pending() && !self.decider.answers_at_once();
            tokio::select! {
                biased;
                () = shutdown.cancelled() => break,
                fetched = self.decider.fetched() => self.deliver(fetched),
                // Before the clock: a camera whose frames wait is not silent, only the detector is slow.
                incoming = self.parts.receiver.ring.next(), if !waits => self.process(incoming),
                () = at(due), if !waits => self.tick(),
            }
        }
        while self.decider.is_pending() {
            let fetched = self.decider.fetched().await;
            self.deliver(fetched);
        }
        if let Some(settled) = &mut self.settled {
            settled.flush();
        }
        self.end();
    }

    fn tick(&mut self) {
        self.count_others();
        self.parts.hand_over(self.tracker.tick(Instant::now()));
        if let Some(settled) = &mut self.settled {
            settled.tick();
        }
    }

    /// Takes no more frames, counts those that wait, and ends the open clip. The second time there is nothing to do.
    fn end(&mut self) {
        let parts = &self.parts;
        for mut frame in parts.receiver.ring.close() {
            let reason = "the camera's loop ended before its turn";
            (parts.receiver).count_dropped(|dropped| &mut dropped.stopped, 1, &reason);
            frame.answer(Some(reason));
        }
        parts.audit.give_up();
        self.count_others();
        let parts = &self.parts;
        parts.hand_over(self.tracker.nothing_is_pending());
        parts.hand_over(self.tracker.shutdown(Instant::now()));
    }

    /// Counts for the open clip what others have counted: dropped frames, and what the audit has found. Without one it goes
    /// to the next.
    fn count_others(&mut self) {
        if self.tracker.clip().is_some() {
            let (dropped, found) = self.parts.board.take_unreported();
            self.tracker.count_others(&dropped, &found);
        }
    }

    fn process(&mut self, mut incoming: SequencedFrame) {
        incoming.answer(None);
        let Some(mut frame) = self.begin(incoming) else {
            return;
        };
        let deciding = Instant::now();
        let need = self.decider.policy.frame(frame.head, &mut self.outcome);
        frame.times.latency.policy = milliseconds(deciding.elapsed());
        if need == Need::Nothing {
            return self.conclude(&frame);
        }
        if self.decider.answers_at_once() {
            let message = self.answer(&frame, true);
            self.tracker.pending(message.seq, frame.threshold);
            frame.first_answer = Some(frame.incoming.frame.received.elapsed());
        }
        self.decider.fetch(frame, need);
    }

    fn deliver(&mut self, fetched: Fetched) {
        let decided = self.decider.deliver(fetched, &mut self.outcome);
        self.finish(decided);
    }

    /// Publishes and counts the final answer of a frame that was pending, if there is one.
    fn finish(&mut self, decided: Option<Decided>) {
        match decided {
            Some(Ok(frame)) => self.conclude(&frame),
            Some(Err(fault)) => (self.parts.receiver).count_dropped(kind_of(&fault), 1, &fault),
            None => {}
        }
    }

    /// Publishes and counts the final answer of a frame, whose first one may have been published, and leaves the frame to
    /// the audit if it is drawn.
    fn conclude(&mut self, frame: &BegunFrame) {
        let message = self.answer(frame, false);
        let BegunFrame { incoming, .. } = frame;
        let first_answer =
            (frame.first_answer).unwrap_or_else(|| incoming.frame.received.elapsed());
        let record = FrameRecord {
            times: frame.times,
            ..FrameRecord::new(message, first_answer)
        };
        let (parts, outcome) = (&self.parts, &self.outcome);
        match frame.first_answer {
            Some(_) => parts.hand_over(self.tracker.count_late(&record)),
            None => self.tracker.count(&record),
        }
        parts.board.record_frame(&record);
        let skipped = outcome.state.is_skipped() && !outcome.degraded;
        if skipped && parts.audit.draws(incoming.index) {
            parts.audit.offer(DrawnFrame {
                picture: incoming.frame.picture.clone(),
                shown: outcome.boxes.clone(),
            });
        }
    }

    /// Prepares for a frame: its place in the stream, the threshold in force, its clip. `None` for one that was overtaken.
    fn begin(&mut self, incoming: SequencedFrame) -> Option<BegunFrame> {
        let taken = Instant::now();
        let frame = &incoming.frame;
        let before = self.newest;
        if before.is_some_and(|(index, _)| incoming.index <= index) {
            let sequence = frame.sequence;
            let reason = format_args!("sequence number {sequence} was overtaken on its way");
            (self.parts.receiver).count_dropped(|dropped| &mut dropped.late, 1, &reason);
            return None;
        }
        self.newest = Some((incoming.index, incoming.epoch));
        let restarted = before.is_some_and(|(_, epoch)| epoch != incoming.epoch);
        let new_clip = frame.clip.is_some() && frame.clip != self.clip;
        if restarted || (new_clip && self.parts.reset_at_clip && self.clip.is_some()) {
            let given_up = self.decider.give_up(&mut self.outcome);
            self.finish(given_up.map(Ok));
            self.decider.policy.reset();
            self.first_index = None;
        }
        self.clip.clone_from(&frame.clip);
        self.take_threshold();

        let known = self.first_index.and(before);
        let step = known.map_or(1, |(last, _)| incoming.index - last);
        let head = FrameHead {
            index: incoming.index - *self.first_index.get_or_insert(incoming.index),
            step: u32::try_from(step).unwrap_or(u32::MAX),
            picture: frame.picture.size,
        };
        // What was dropped before this frame belongs to the clip that was open then.
        self.count_others();
        let parts = &self.parts;
        let clip = frame.clip.as_deref();
        parts.hand_over(self.tracker.arrive(frame.time_ns, clip, frame.received));
        let clip = self.tracker.clip().map_or_else(|| "".into(), Arc::clone);
        let knob = (parts.board.knob).zip(self.decider.policy.policy().knob_value());
        Some(BegunFrame {
            head,
            clip,
            threshold: knob.map(|(knob, value)| Threshold::new(knob.name, value)),
            taken,
            incoming,
            first_answer: None,
            times: Times::default(),
        })
    }

    /// Publishes an answer of a frame: a `pending` one, before the final one, or that. Of the boxes in the outcome those
    /// stay that are published.
    fn answer(&mut self, frame: &BegunFrame, pending: bool) -> Arc<DetectionsMessage> {
        let (parts, outcome) = (&self.parts, &mut self.outcome);
        // The policy sees that the scene is not empty; only this loop knows that the screen was overruled.
        if outcome.cause == Some(CallCause::Screen) && frame.times.overruled {
            outcome.cause = Some(CallCause::EmptyLimit);
        }
        let BegunFrame { incoming, .. } = frame;
        let received = incoming.frame.received;
        let late = frame.first_answer.is_some();
        match &mut self.settled {
            Some(settled) if late => settled.late(incoming.index, outcome),
            Some(settled) => settled.frame(incoming, &frame.clip, outcome, pending),
            None => {}
        }
        parts.min_confidence.select(&mut outcome.boxes);
        let class_names = &parts.class_names;
        let message = Arc::new(DetectionsMessage {
            pending,
            threshold: frame.threshold,
            latency_ms: Latency {
                total: milliseconds(received.elapsed()),
                waiting: milliseconds(frame.taken - received),
                ..frame.times.latency
            },
            ..detections_message(outcome, &incoming.frame, &frame.clip, class_names)
        });
        if late {
            if let Some(late) = &parts.late {
                late.put(&*message);
            }
            parts.board.show_late(Arc::clone(&message));
        } else {
            parts.detections.put(&*message);
            parts.board.show(Arc::clone(&message));
        }
        message
    }

    /// Takes a changed threshold over, so that it holds from this frame on.
    fn take_threshold(&mut self) {
        if !self.threshold.has_changed().unwrap_or(false) {
            return;
        }
        if let Some(value) = *self.threshold.borrow_and_update()
            && let Err(error) = self.decider.policy.set_knob(value)
        {
            tracing::error!(camera = self.parts.board.name(), %error, "threshold not taken by the policy");
        }
    }
}

/// Also where the loop panicked or was given up: what was counted until then is reported.
impl Drop for Camera {
    fn drop(&mut self) {
        // What panicked may be what is asked here; a second panic must not end the process.
        if catch_unwind(AssertUnwindSafe(|| self.end())).is_err() {
            tracing::error!(camera = self.parts.board.name(), "the open clip is lost");
        }
    }
}

/// Waits until `due`; forever without one.
async fn at(due: Option<Instant>) {
    match due {
        Some(due) => tokio::time::sleep_until(due).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests;
