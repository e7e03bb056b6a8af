//! A camera's loop: takes frames from the ring, drives the policy through each, publishes the answer and
//! counts the open clip. One task a camera; the detector, the screen and the meter are shared.

pub mod answer;
pub mod audit;
pub mod clip;
pub mod evidence;
mod published;
pub(crate) mod publishing;

pub(crate) use published::MinConfidence;
pub use published::ReportConfig;

use crate::camera::answer::{AnswerContext, detections_message};
use crate::camera::audit::{CameraAudit, DrawnFrame};
use crate::camera::clip::{FrameArrival, FrameResult};
use crate::camera::evidence::LiveEvidence;
use crate::camera::publishing::Detections;
use crate::delivery::report::ClipAccounts;
use crate::input::RingReceiver;
use crate::input::receiver::{DropCounts, DropKind, SequencedFrame};
use crate::state::board::CameraBoard;
use albireo_core::policy::{
    CallCause, Evidence, EvidenceSource, FrameHead, Need, Outcome, Policy, decide,
};
use albireo_service::clock::milliseconds;
use albireo_vision::picture::{EncodedPicture, FrameFault};
use albireo_wire::{Latency, Threshold};
use std::future::Future;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
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
    /// What decides.
    pub policy: Box<dyn Policy>,
    /// Where its evidence comes from.
    pub evidence: LiveEvidence,
    /// Where detections go.
    pub detections: Arc<Detections>,
    /// Which boxes are published.
    pub min_confidence: MinConfidence,
    /// Names of the detector's classes.
    pub class_names: Arc<[String]>,
    /// Where clips are closed and reported.
    pub accounts: ClipAccounts,
    /// Where frames are left that the detector is to look at afterwards.
    pub audit: Arc<CameraAudit>,
    /// Whether a new clip id of the camera makes the policy forget its objects.
    pub reset_at_clip: bool,
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

impl Camera {
    /// Runs until `shutdown` or until the ring closes; finishes the frame in hand and closes the open
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
            let due = self.accounts.deadline();
            tokio::select! {
                biased;
                () = shutdown.cancelled() => break,
                // Before the clock: a camera whose frames wait is not silent, only the detector is slow.
                incoming = self.ring.next() => match incoming {
                    Some(incoming) => self.process(incoming, &mut stream).await,
                    None => break,
                },
                () = at(due) => self.accounts.tick(),
            }
        }
        self.end();
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
        let taken = Instant::now();
        let frame = &incoming.frame;
        if stream
            .newest
            .is_some_and(|(index, _)| incoming.index <= index)
        {
            let sequence = frame.sequence;
            let reason = format_args!("sequence number {sequence} was overtaken on its way");
            return self.drops.count(DropKind::Late, 1, &reason);
        }
        let restarted = stream
            .newest
            .replace((incoming.index, incoming.epoch))
            .is_some_and(|(_, epoch)| epoch != incoming.epoch);
        let new_clip = frame.clip.is_some() && frame.clip != stream.clip;
        if restarted || (new_clip && self.reset_at_clip && stream.clip.is_some()) {
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
        let mut source = FrameSource {
            evidence: &mut self.evidence,
            ring: &self.ring,
            incoming: &incoming,
            head,
        };
        let deciding = Instant::now();
        let decided = decide(&mut *self.policy, head, &mut source, &mut stream.outcome).await;
        let deciding = deciding.elapsed();
        self.evidence.end_frame();
        if let Err(fault) = decided {
            return self.drops.count(DropKind::from(&fault), 1, &fault);
        }

        // The policy is told that the scene is not empty; that the screen was overruled is known here.
        if stream.outcome.cause == Some(CallCause::Screen) && self.evidence.screen_is_overruled() {
            stream.outcome.cause = Some(CallCause::EmptyLimit);
        }
        self.min_confidence.select(&mut stream.outcome.boxes);
        let times = self.evidence.times();
        let message = detections_message(
            &stream.outcome,
            &AnswerContext {
                frame,
                clip: &clip,
                threshold: self
                    .board
                    .knob()
                    .zip(self.policy.knob_value())
                    .map(|(knob, value)| Threshold::new(knob.name, value)),
                class_names: &self.class_names,
                latency: Latency {
                    total: milliseconds(frame.received.elapsed()),
                    waiting: milliseconds(taken - frame.received),
                    decode: times.decode.map(milliseconds),
                    screen: times.screen.map(milliseconds),
                    detector: times.detector().map(milliseconds),
                    policy: milliseconds(deciding.saturating_sub(times.evidence)),
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
        if let Some(run) = times.detector_run {
            self.accounts.detector_ran(run);
            self.board.record_detector(run.used);
        }
        self.accounts.count(&FrameResult {
            seq: frame.sequence,
            state: message.state,
            degraded: message.degraded,
            total: frame.received.elapsed(),
            detector: times.detector(),
            threshold: message.threshold,
        });
        if times.looked {
            self.board.record_look();
        }
        self.board.record_screen(self.evidence.screen_overruled());
        self.board.record_frame(Arc::new(message));
        self.audit(&incoming, stream);
    }

    /// Leaves the frame to be looked at if it is drawn; its answer is out.
    fn audit(&self, incoming: &SequencedFrame, stream: &Stream) {
        let outcome = &stream.outcome;
        let skipped = outcome.state.is_skipped() && !outcome.degraded;
        if skipped && self.audit.draws(incoming.index) {
            self.audit.offer(DrawnFrame {
                picture: incoming.frame.picture.clone(),
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
            && let Err(error) = self.policy.set_knob(value)
        {
            tracing::error!(camera = self.board.name(), %error, "threshold not taken by the policy");
        }
    }
}

/// One frame's evidence, and a look at the next frame.
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
