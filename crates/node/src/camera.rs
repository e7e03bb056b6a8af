//! A camera's loop: takes frames from the ring, drives the policy through each, publishes the answers and
//! counts the open clip. One task per camera; the detector, the screen and the meter are shared.

pub mod answer;
pub mod audit;
pub mod clip;
mod config;
mod decider;
pub mod evidence;
mod published;
pub(crate) mod publishing;
mod record;
mod settled;

pub use config::{AnswerTime, SettleConfig};
pub(crate) use decider::Decider;
pub use published::ReportConfig;
pub use record::FrameRecord;
pub(crate) use settled::SettledStream;
#[cfg(test)]
pub(crate) use tests::answer;

use crate::camera::answer::{AnswerContext, detections_message};
use crate::camera::audit::{CameraAudit, DrawnFrame};
use crate::camera::clip::{ClipTracker, ClosedClip, FrameArrival};
use crate::camera::decider::PendingFrame;
use crate::camera::evidence::Times;
use crate::camera::publishing::Outlet;
use crate::camera::settled::FrameLabel;
use crate::input::Ring;
use crate::input::receiver::{DropCounts, SequencedFrame, kind_of};
use crate::state::board::CameraBoard;
use albireo_core::policy::{CallCause, FrameHead, MinConfidence, Need, Outcome};
use albireo_service::clock::milliseconds;
use albireo_wire::{DetectionsMessage, Latency, Threshold};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// What stays of a camera when its loop is built anew.
pub(crate) struct CameraParts {
    /// What HTTP and metrics see of it.
    pub board: Arc<CameraBoard>,
    /// Frames from the receiver.
    pub ring: Arc<Ring<SequencedFrame>>,
    /// Dropped frames, shared with the receiver.
    pub drops: Arc<DropCounts>,
    /// Where answers go.
    pub detections: Outlet,
    /// Where the final answers of pending frames go, if frames are answered at once.
    pub late: Option<Outlet>,
    /// Where every frame goes once more when its boxes are settled.
    pub settled: Option<Arc<Outlet>>,
    /// Which boxes are published.
    pub min_confidence: MinConfidence,
    /// Names of the detector's classes.
    pub class_names: Arc<[String]>,
    /// Where closed clips go. Unbounded, because a clip is some kilobytes every some seconds and must not be lost; their
    /// reporter's own waiting is bounded.
    pub closed: mpsc::UnboundedSender<ClosedClip>,
    /// Where frames are left that the detector is to examine afterwards.
    pub audit: Arc<CameraAudit>,
    /// Whether a new clip id of the camera makes the policy forget its objects.
    pub reset_at_clip: bool,
}

/// One camera's loop: knows nothing of frames before it was built.
pub(crate) struct Camera {
    pub parts: Arc<CameraParts>,
    /// What decides frames.
    pub decider: Decider,
    /// The frames that are held back until their boxes are settled.
    pub settled: Option<SettledStream>,
    /// The open clip.
    pub clip: ClipTracker,
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
    /// Runs until `shutdown`; finishes the current or pending frame, and closes the open clip.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        let mut stream = Stream {
            threshold: self.parts.board.watch_threshold(),
            last_index: None,
            newest: None,
            first_index: 0,
            clip: None,
            outcome: Outcome::default(),
        };
        stream.threshold.mark_changed();
        loop {
            let settled = self.settled.as_ref().and_then(SettledStream::deadline);
            let due = self.clip.deadline().into_iter().chain(settled).min();
            // Where a frame is answered when everything is known, those after it wait.
            let waits = self.decider.is_pending() && !self.decider.answers_at_once();
            tokio::select! {
                biased;
                () = shutdown.cancelled() => break,
                fetched = self.decider.fetched() => {
                    let decided = self.decider.deliver(fetched, &mut stream.outcome);
                    self.finish(decided, &mut stream.outcome);
                }
                // Before the clock: a camera whose frames wait is not silent, only the detector is slow.
                incoming = self.parts.ring.next(), if !waits => self.process(incoming, &mut stream),
                () = at(due), if !waits => self.tick(),
            }
        }
        while self.decider.is_pending() {
            let fetched = self.decider.fetched().await;
            let decided = self.decider.deliver(fetched, &mut stream.outcome);
            self.finish(decided, &mut stream.outcome);
        }
        if let Some(settled) = &mut self.settled {
            settled.flush();
            settled.publish();
        }
        self.end();
    }

    fn tick(&mut self) {
        self.count_others();
        let closed = self.clip.tick(Instant::now());
        self.hand_over(closed);
        if let Some(settled) = &mut self.settled {
            settled.tick();
            settled.publish();
        }
    }

    /// Takes no more frames, counts those that wait, and ends the open clip. The second time there is nothing to do.
    fn end(&mut self) {
        for mut frame in self.parts.ring.close() {
            let reason = "the camera's loop ended before its turn";
            self.parts
                .drops
                .count(|dropped| &mut dropped.stopped, 1, &reason);
            frame.refuse(reason);
        }
        self.parts.audit.give_up();
        self.count_others();
        let ended = self.clip.nothing_is_pending();
        self.hand_over(ended);
        let closed = self.clip.shutdown(Instant::now());
        self.hand_over(closed);
    }

    /// Counts for the open clip what others have counted: dropped frames, and what the audit has found. Without one it goes
    /// to the next.
    fn count_others(&mut self) {
        if self.clip.clip().is_some() {
            let (dropped, found) = (self.parts.drops.take(), self.parts.audit.take());
            self.clip.count_others(&dropped, found.as_deref());
        }
    }

    fn hand_over(&self, closed: Option<ClosedClip>) {
        if let Some(closed) = closed
            && self.parts.closed.send(closed).is_err()
        {
            tracing::error!("a clip ended and its reporter has stopped");
        }
    }

    fn process(&mut self, mut incoming: SequencedFrame, stream: &mut Stream) {
        incoming.taken();
        let Some(frame) = self.begin(incoming, stream) else {
            return;
        };
        let outcome = &mut stream.outcome;
        let deciding = Instant::now();
        let need = self.decider.frame(frame.head, outcome);
        let times = Times {
            policy: deciding.elapsed(),
            ..Times::default()
        };
        if need == Need::Nothing {
            return self.conclude(&frame, outcome, times, None);
        }
        let mut first_answer = None;
        if self.decider.answers_at_once() {
            let message = self.answer(&frame, outcome, &times, Answer::Pending);
            self.clip.pending(message.seq, frame.threshold);
            first_answer = Some(frame.incoming.frame.received.elapsed());
        }
        self.decider.fetch(frame, need, first_answer, times);
    }

    /// Publishes and counts the final answer of a frame that was pending, if there is one.
    fn finish(&mut self, decided: Option<PendingFrame>, outcome: &mut Outcome) {
        let Some(PendingFrame {
            frame,
            first_answer,
            times,
            fault,
            ..
        }) = decided
        else {
            return;
        };
        if let Some(fault) = fault {
            return self.parts.drops.count(kind_of(&fault), 1, &fault);
        }
        self.conclude(&frame, outcome, times, first_answer);
    }

    /// Publishes and counts the final answer of a frame, whose first one may have been published.
    fn conclude(
        &mut self,
        frame: &BegunFrame,
        outcome: &mut Outcome,
        times: Times,
        first_answer: Option<Duration>,
    ) {
        let answer = match first_answer {
            Some(_) => Answer::Late,
            None => Answer::Final,
        };
        let message = self.answer(frame, outcome, &times, answer);
        let received = frame.incoming.frame.received;
        let record = FrameRecord {
            times,
            ..FrameRecord::new(message, first_answer.unwrap_or_else(|| received.elapsed()))
        };
        self.count(&record, frame, outcome, answer);
    }

    /// Prepares for a frame: its place in the stream, the threshold in force, its clip. `None` for one that was overtaken.
    fn begin(&mut self, incoming: SequencedFrame, stream: &mut Stream) -> Option<BegunFrame> {
        let taken = Instant::now();
        let frame = &incoming.frame;
        if stream
            .newest
            .is_some_and(|(index, _)| incoming.index <= index)
        {
            let sequence = frame.sequence;
            let reason = format_args!("sequence number {sequence} was overtaken on its way");
            self.parts
                .drops
                .count(|dropped| &mut dropped.late, 1, &reason);
            return None;
        }
        let restarted = stream
            .newest
            .replace((incoming.index, incoming.epoch))
            .is_some_and(|(_, epoch)| epoch != incoming.epoch);
        let new_clip = frame.clip.is_some() && frame.clip != stream.clip;
        if restarted || (new_clip && self.parts.reset_at_clip && stream.clip.is_some()) {
            let given_up = self.decider.give_up(&mut stream.outcome);
            self.finish(given_up, &mut stream.outcome);
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
        // What was dropped before this frame belongs to the clip that was open then.
        self.count_others();
        let frame = &incoming.frame;
        let closed = self.clip.arrive(&FrameArrival {
            t_ns: frame.time_ns,
            clip: frame.clip.as_deref(),
            arrival: frame.received,
        });
        self.hand_over(closed);
        let clip = self.clip.clip().map_or_else(|| "".into(), Arc::clone);
        let knob = self
            .parts
            .board
            .knob()
            .zip(self.decider.policy().knob_value());
        Some(BegunFrame {
            head,
            clip,
            threshold: knob.map(|(knob, value)| Threshold::new(knob.name, value)),
            taken,
            incoming,
        })
    }

    /// Publishes an answer of a frame. Of the boxes in `outcome` those stay that are published.
    fn answer(
        &mut self,
        frame: &BegunFrame,
        outcome: &mut Outcome,
        times: &Times,
        answer: Answer,
    ) -> Arc<DetectionsMessage> {
        // The policy sees that the scene is not empty; only this loop knows that the screen was overruled.
        if outcome.cause == Some(CallCause::Screen) && times.overruled {
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
        self.parts.min_confidence.select(&mut outcome.boxes);
        let message = Arc::new(detections_message(
            outcome,
            &AnswerContext {
                frame: &incoming.frame,
                clip: &frame.clip,
                pending: answer == Answer::Pending,
                threshold: frame.threshold,
                class_names: &self.parts.class_names,
                latency: Latency {
                    total: milliseconds(received.elapsed()),
                    waiting: milliseconds(frame.taken - received),
                    decode: times.decode.map(milliseconds),
                    screen: times.screen.map(milliseconds),
                    detector: times.detector.map(milliseconds),
                    policy: milliseconds(times.policy),
                },
            },
        ));
        let outlet = match answer {
            Answer::Late => self.parts.late.as_ref(),
            _ => Some(&self.parts.detections),
        };
        match (serde_json::to_vec(&*message), outlet) {
            (Ok(json), Some(outlet)) => outlet.put(json),
            (Ok(_), None) => {}
            (Err(error), _) => {
                tracing::error!(camera = self.parts.board.name(), %error, "detections not written");
            }
        }
        if let Some(settled) = &mut self.settled {
            settled.publish();
        }
        match answer {
            Answer::Late => self.parts.board.show_late(Arc::clone(&message)),
            _ => self.parts.board.show(Arc::clone(&message)),
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
        if answer == Answer::Late {
            let closed = self.clip.count_late(record);
            self.hand_over(closed);
        } else {
            self.clip.count(record);
        }
        self.parts.board.record_frame(record);
        let skipped = outcome.state.is_skipped() && !outcome.degraded;
        if skipped && self.parts.audit.draws(frame.incoming.index) {
            self.parts.audit.offer(DrawnFrame {
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

/// Waits until `due`; for ever without one.
async fn at(due: Option<Instant>) {
    match due {
        Some(due) => tokio::time::sleep_until(due).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests;
