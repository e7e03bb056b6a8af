//! A camera's loop: takes frames from the ring, runs the policy on each, publishes the answers and counts the
//! open clip. One task per camera; the detector, the screen and the meter are shared.

pub mod answer;
pub mod audit;
pub mod clip;
mod config;
mod decider;
pub mod evidence;
mod in_force;
mod rate;
mod settled;

pub use config::{AnswerTime, PublishConfig, ReportConfig, SettleConfig};
#[cfg(test)]
pub(crate) use tests::answer;

use crate::camera::answer::detections_message;
use crate::camera::audit::{AuditConfig, CameraAudit};
use crate::camera::clip::{Clip, ClipConfig, ClipTracker};
use crate::camera::decider::{Decider, Fetched};
use crate::camera::evidence::LiveEvidence;
use crate::camera::rate::FrameRate;
use crate::camera::settled::SettledStream;
use crate::error::NodeError;
use crate::frame::{FrameRecord, Times};
use crate::input::receiver::{FrameReceiver, SequencedFrame, kind_of};
use crate::position::Positions;
use crate::publishing::Outlet;
use crate::publishing::ros2::Ros2Outlet;
use crate::recorder::CameraRecorder;
use crate::state::board::{CameraBoard, InForce, NodePolicy};
use albireo_core::policy::{
    CallCause, EmptyRoad, FrameHead, LatePolicy, MinConfidence, Need, Outcome, Policy,
    PolicyConfig, PolicyConfigError,
};
use albireo_power::CameraEnergy;
use albireo_service::clock::milliseconds;
use albireo_wire::{DetectionsMessage, DropKind, Latency, Position, Threshold};
use futures_util::future::OptionFuture;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

/// After broken pictures for this long, where objects are is not known any more: nothing is reported until a whole one.
const LONGEST_BLIND: Duration = Duration::from_secs(2);

/// Creates a camera's policy from the configuration of the policy in force: at the start of its loop, whenever that has failed, and
/// when the policy is switched: `|camera, config| policy`.
pub type PolicyMaker =
    Arc<dyn Fn(&str, &PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError> + Send + Sync>;

/// The parts of a camera that survive a restart of its loop.
pub(crate) struct CameraParts {
    /// Shows the camera in HTTP and metrics.
    pub board: Arc<CameraBoard>,
    /// The source of its frames.
    pub receiver: Arc<FrameReceiver>,
    /// Creates its policy.
    pub policies: PolicyMaker,
    /// Publishes the answers.
    pub detections: Outlet,
    /// Publishes the final answers of pending frames, if frames are answered at once.
    pub late: Option<Outlet>,
    /// Publishes every frame again once its boxes are settled.
    pub settled: Option<Outlet>,
    /// Publishes the answers for ROS 2, too.
    pub ros2: Option<Ros2Outlet>,
    /// Selects the boxes to publish.
    pub min_confidence: MinConfidence,
    /// The names of the detector's classes.
    pub class_names: Vec<String>,
    /// Sends closed clips. Unbounded, because a clip is a few kilobytes every few seconds and must not be lost; the
    /// reporter's wait per clip is bounded.
    pub closed: mpsc::UnboundedSender<Clip>,
    /// The camera's share of the node's energy.
    pub energy: CameraEnergy,
    /// Where its frames are taken.
    pub positions: Arc<Positions>,
    /// Records its frames.
    pub recorder: CameraRecorder,
    /// True if the policy forgets its objects at a new clip id of the camera.
    pub reset_at_clip: bool,
}

/// The settings of a camera's loop.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LoopSettings {
    /// When its clips end.
    pub clip: ClipConfig,
    /// The share of its skipped frames that is examined.
    pub audit: AuditConfig,
    /// The longest time that a settled frame is held back.
    pub longest_hold: Duration,
}

impl CameraParts {
    /// Creates the policy of this configuration, at the start of a stream.
    fn policy(&self, config: &PolicyConfig) -> Result<LatePolicy, NodeError> {
        let policy = (self.policies)(self.board.name(), config).map_err(NodeError::new)?;
        if self.late.is_some() {
            LatePolicy::new(policy).map_err(NodeError::new)
        } else {
            Ok(LatePolicy::waiting(policy))
        }
    }

    fn hand_over(&self, closed: Option<Clip>) {
        let Some(closed) = closed else { return };
        if self.closed.send(closed).is_err() {
            tracing::error!("a clip is lost: its reporter has stopped");
        }
    }
}

/// One camera's loop.
pub(crate) struct Camera {
    parts: Arc<CameraParts>,
    /// The policy that it was last told to follow.
    policy: Arc<NodePolicy>,
    /// Decides frames.
    decider: Decider,
    /// The frames held back until their boxes are settled.
    settled: Option<SettledStream>,
    /// The open clip.
    tracker: ClipTracker,
    /// The frames that the detector examines afterwards.
    audit: CameraAudit,
    in_force: watch::Receiver<InForce>,
    empty_road: watch::Receiver<EmptyRoad>,
    rate: FrameRate,
    /// True once it was said what the pause on an empty road means at the camera's rate.
    pause_is_told: bool,
    /// The place of the newest frame of the camera so far.
    newest: Option<StreamPlace>,
    /// The index of the policy's first frame, from which it counts.
    first_index: Option<u64>,
    /// The arrival of the first of the broken frames in a row up to now.
    broken_since: Option<Instant>,
    /// The camera's name for the clip of the previous frame.
    previous_clip: Option<Arc<str>>,
    outcome: Outcome,
}

/// Which of its answers a frame gets.
#[derive(Clone, Copy, PartialEq, Eq)]
enum AnswerStage {
    /// A prediction, which the final answer follows.
    Pending,
    Final,
}

/// The place of a frame in what its camera sends.
#[derive(Clone, Copy)]
struct StreamPlace {
    /// Its number.
    index: u64,
    /// The number of its stream: a camera that restarts begins another.
    epoch: u64,
}

/// A frame in progress.
struct BegunFrame {
    incoming: SequencedFrame,
    head: FrameHead,
    clip: Arc<str>,
    threshold: Option<Threshold>,
    /// Where it was taken.
    position: Option<Position>,
    /// What the policy needs to know of it.
    need: Need,
    /// The time at which it was taken from the ring.
    taken: Instant,
    /// The time from reception to its prediction, if that was published before the final answer.
    first_answer: Option<Duration>,
    /// The time spent on its answer so far.
    times: Times,
}

impl Camera {
    /// Creates a loop that has seen no frame, under the policy in force. It begins a new clip, and applies the threshold in
    /// force at its first frame.
    ///
    /// # Errors
    /// [`NodeError`] if the policy cannot be created.
    pub(crate) fn new(
        parts: Arc<CameraParts>,
        settings: LoopSettings,
        evidence: LiveEvidence,
        audit: CameraAudit,
    ) -> Result<Self, NodeError> {
        let mut in_force = parts.board.watch_in_force();
        let config = Arc::clone(&in_force.borrow_and_update().policy);
        // So that the first frame applies the threshold.
        in_force.mark_changed();
        let policy = parts.policy(&config.config)?;
        parts.receiver.ring.open();
        let settled = if parts.settled.is_some() {
            Some(SettledStream::new(settings.longest_hold, &parts))
        } else {
            None
        };
        let energy = parts.energy.clone();
        let name = policy.policy().name();
        Ok(Self {
            policy: config,
            decider: Decider::new(policy, evidence),
            settled,
            tracker: ClipTracker::new(settings.clip, energy, settings.audit.report(), name),
            audit,
            in_force,
            empty_road: parts.board.watch_empty_road(),
            rate: FrameRate::default(),
            pause_is_told: false,
            newest: None,
            first_index: None,
            broken_since: None,
            previous_clip: None,
            outcome: Outcome::default(),
            parts,
        })
    }

    /// Runs until `shutdown`, then finishes the current or pending frame and closes the open clip.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        loop {
            let clip_ends = self.tracker.deadline();
            let hold_ends = self.settled.as_ref().and_then(SettledStream::deadline);
            let due = [clip_ends, hold_ends].into_iter().flatten().min();
            // If frames are answered only when everything is known, later frames wait.
            let waits = self.decider.is_pending() && !self.decider.answers_at_once();
            tokio::select! {
                biased;
                () = shutdown.cancelled() => break,
                fetched = self.decider.fetched() => self.deliver(fetched),
                () = self.audit.run() => {}
                // Before the clock: a camera with waiting frames is not silent, only the detector is slow.
                incoming = self.parts.receiver.ring.next(), if !waits => self.process(incoming),
                Some(()) = OptionFuture::from(due.map(sleep_until)), if !waits => self.tick(),
            }
        }
        while self.decider.is_pending() {
            let fetched = self.decider.fetched().await;
            self.deliver(fetched);
        }
        if let Some(settled) = &mut self.settled {
            settled.end_stream();
        }
    }

    fn tick(&mut self) {
        self.count_unreported();
        self.parts.hand_over(self.tracker.tick(Instant::now()));
        if let Some(settled) = &mut self.settled {
            settled.tick();
        }
    }

    /// Stops taking frames, counts the waiting ones as dropped, and ends the open clip.
    fn end(&mut self) {
        let parts = &self.parts;
        for frame in parts.receiver.ring.close() {
            let reason = "the camera's loop ended before its turn";
            parts.receiver.count_dropped(DropKind::Stopped, 1, &reason);
            parts.receiver.answer(frame.query, Some(reason));
        }
        self.audit.give_up();
        self.count_unreported();
        let parts = &self.parts;
        parts.hand_over(self.tracker.nothing_is_pending());
        parts.hand_over(self.tracker.shutdown(Instant::now()));
    }

    /// Adds the dropped frames and audit results since the last call to the open clip. Without an open clip, they go
    /// to the next one.
    fn count_unreported(&mut self) {
        if self.tracker.clip().is_some() {
            let unreported = self.parts.board.take_unreported();
            self.tracker.count_unreported(&unreported);
        }
    }

    fn process(&mut self, mut incoming: SequencedFrame) {
        self.parts.receiver.answer(incoming.query.take(), None);
        let mut frame = self.begin(incoming);
        let deciding = Instant::now();
        frame.need = self.decider.ask(&frame, &mut self.outcome);
        frame.times.latency.policy = milliseconds(deciding.elapsed());
        if frame.need == Need::Nothing {
            return self.conclude(&frame);
        }
        if frame.incoming.is_broken {
            if let Some(frame) = self.decider.without_evidence(frame, &mut self.outcome) {
                self.conclude(&frame);
            }
            return;
        }
        if self.decider.answers_at_once() {
            let message = self.answer(&frame, AnswerStage::Pending);
            self.tracker.pending(message.seq, frame.threshold);
            frame.first_answer = Some(frame.incoming.frame.received.elapsed());
        }
        self.decider.fetch(frame);
    }

    /// Gives the evidence to the frame that waits for it, and concludes the frame if it needs nothing more.
    fn deliver(&mut self, fetched: Fetched) {
        match self.decider.deliver(fetched, &mut self.outcome) {
            Some(Ok(frame)) => self.conclude(&frame),
            Some(Err(fault)) => self.parts.receiver.count_dropped(kind_of(&fault), 1, &fault),
            None => {}
        }
    }

    /// Publishes and counts the final answer of a frame, whose first answer may already be published, and offers the
    /// frame to the audit if it is drawn.
    fn conclude(&mut self, frame: &BegunFrame) {
        let message = self.answer(frame, AnswerStage::Final);
        let incoming = &frame.incoming;
        let first_answer = frame.first_answer.unwrap_or_else(|| incoming.frame.received.elapsed());
        let record = FrameRecord {
            times: frame.times,
            ..FrameRecord::new(message, first_answer)
        };
        let parts = &self.parts;
        let outcome = &self.outcome;
        match frame.first_answer {
            Some(_) => parts.hand_over(self.tracker.count_late(&record)),
            None => self.tracker.count(&record),
        }
        parts.board.record_frame(&record);
        let received = incoming.frame.received.into_std();
        let picture = &incoming.frame.picture;
        parts.recorder.frame(picture, &record.detections, frame.position, received);
        if outcome.state.is_skipped() && !outcome.degraded {
            self.audit.offer(incoming.index, picture, &outcome.boxes, &record.detections);
        }
    }

    /// Prepares a frame: its place in the stream, the threshold in force, its clip.
    fn begin(&mut self, incoming: SequencedFrame) -> BegunFrame {
        let taken = Instant::now();
        let frame = &incoming.frame;
        let before = self.newest.replace(StreamPlace {
            index: incoming.index,
            epoch: incoming.epoch,
        });
        if self.forgets_objects(&incoming, before) {
            self.conclude_pending();
            self.decider.policy.reset();
            self.first_index = None;
        }
        self.previous_clip.clone_from(&frame.clip);
        self.take_in_force(frame.received);

        // Without a first index the policy has just begun, and knows no frame before this one.
        let step = match before {
            Some(before) if self.first_index.is_some() => incoming.index - before.index,
            _ => 1,
        };
        let first_index = *self.first_index.get_or_insert(incoming.index);
        let head = FrameHead {
            index: incoming.index - first_index,
            step: u32::try_from(step).unwrap_or(u32::MAX),
            picture: frame.picture.size,
        };
        self.rate.add(frame.time_ns, head.step);
        self.show_no_news();
        self.apply_pause();
        // Frames dropped before this one belong to the clip that was open then.
        self.count_unreported();
        let parts = &self.parts;
        let named_clip = frame.clip.as_deref();
        parts.hand_over(self.tracker.arrive(frame.time_ns, named_clip, frame.received));
        let position = parts.positions.of_frame(parts.board.name(), frame.position.as_ref());
        if let Some(position) = position {
            self.tracker.locate(position, frame.time_ns, frame.received);
        }
        let clip = self.tracker.clip().map_or_else(|| "".into(), Arc::clone);
        let threshold = match (self.policy.spec, self.decider.policy.policy().threshold()) {
            (Some(spec), Some(value)) => Some(Threshold::new(spec.name, value)),
            _ => None,
        };
        BegunFrame {
            head,
            clip,
            threshold,
            position,
            need: Need::Nothing,
            taken,
            incoming,
            first_answer: None,
            times: Times::default(),
        }
    }

    /// True if the policy must not carry its objects over to this frame: another stream begins, too many pictures were
    /// broken, or a clip begins at which they are to be forgotten.
    fn forgets_objects(&mut self, incoming: &SequencedFrame, before: Option<StreamPlace>) -> bool {
        let frame = &incoming.frame;
        let is_blind = if incoming.is_broken {
            let since = *self.broken_since.get_or_insert(frame.received);
            frame.received.saturating_duration_since(since) > LONGEST_BLIND
        } else {
            self.broken_since = None;
            false
        };
        let is_restart = before.is_some_and(|before| before.epoch != incoming.epoch);
        let previous_clip = &self.previous_clip;
        let is_new_clip =
            previous_clip.is_some() && frame.clip.is_some() && frame.clip != *previous_clip;
        is_restart || is_blind || (is_new_clip && self.parts.reset_at_clip)
    }

    /// Publishes an answer of a frame. Leaves only the published boxes in the outcome.
    fn answer(&mut self, frame: &BegunFrame, stage: AnswerStage) -> Arc<DetectionsMessage> {
        let parts = &self.parts;
        let outcome = &mut self.outcome;
        // The policy sees that the scene is not empty; only this loop knows that the screen was overruled.
        if outcome.cause == Some(CallCause::Screen) && frame.times.overruled {
            outcome.cause = Some(CallCause::EmptyLimit);
        }
        let incoming = &frame.incoming;
        let received = incoming.frame.received;
        let is_pending = stage == AnswerStage::Pending;
        let is_late = frame.first_answer.is_some();
        // Its object may have moved into the mask since the detector saw it.
        outcome.boxes.retain(|one| !parts.receiver.hides(one.bounding_box));
        match &mut self.settled {
            Some(settled) if is_late => settled.late(incoming.index, outcome),
            Some(settled) => settled.frame(incoming, &frame.clip, outcome, is_pending),
            None => {}
        }
        parts.min_confidence.select(&mut outcome.boxes);
        let class_names = &parts.class_names;
        let message = Arc::new(DetectionsMessage {
            pending: is_pending,
            threshold: frame.threshold,
            latency_ms: Latency {
                total: milliseconds(received.elapsed()),
                waiting: milliseconds(frame.taken - received),
                ..frame.times.latency
            },
            ..detections_message(outcome, &incoming.frame, &frame.clip, class_names)
        });
        if is_late {
            if let Some(outlet) = &parts.late {
                outlet.put(&*message);
            }
            parts.board.show_late(Arc::clone(&message));
        } else {
            parts.detections.put(&*message);
            if let Some(ros2) = &parts.ros2 {
                ros2.put(&message);
            }
            parts.board.show(Arc::clone(&message), incoming.frame.picture.clone());
        }
        message
    }
}

/// Ends the clip even if the loop panicked or was aborted, so that the counts until then are reported.
impl Drop for Camera {
    fn drop(&mut self) {
        // May panic again for the same cause; a second panic while unwinding must not abort the process.
        if catch_unwind(AssertUnwindSafe(|| self.end())).is_err() {
            tracing::error!(camera = self.parts.board.name(), "the open clip is lost");
        }
    }
}

#[cfg(test)]
mod tests;
