//! One camera's part of the live board.

use super::event::{Event, FrameEvent, SharedEvent, ThresholdEvent};
use super::history::{History, PastFrame, PastSlot, SkipEstimate};
use super::thresholds;
use crate::camera::FrameRecord;
use crate::camera::audit::AuditCount;
use crate::delivery::outbox::Outbox;
use crate::state::advice::{Advice, SkipWatch};
use crate::state::target::NodeTarget;
use albireo_core::audit::AuditSums;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{BoxSource, FrameState, Knob, KnobError, published_threshold, short};
use albireo_vision::picture::EncodedPicture;
use albireo_wire::{
    BoxMessage, DetectionsMessage, DetectorCalls, DroppedFrames, FrameStates, SettingSource,
    Threshold,
};
use parking_lot::Mutex;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::histogram::Histogram;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::{broadcast, watch};
use tokio::time::Instant;

/// Upper bounds of the latency histograms, seconds: fine around the 1 ms a predicted frame may take and
/// around a detector's tens of milliseconds.
pub(crate) const LATENCY_BUCKETS_S: [f64; 15] = [
    0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.02, 0.033, 0.05, 0.1, 0.25, 0.5, 1.0,
    2.5,
];

/// What a camera's part of the board is made from.
#[derive(Clone, Debug)]
pub struct CameraSetup {
    /// The camera's name.
    pub name: String,
    /// Zenoh key its frames come on, unless it has a source.
    pub key: String,
    /// The source that the node opens for it, without credentials.
    pub source: Option<String>,
    /// What its policy lets a user turn, if anything.
    pub knob: Option<Knob>,
    /// The configured value; the knob's default without one. It must be inside the knob's range; a value
    /// that is not is logged and the default used.
    pub threshold: Option<f64>,
    /// Whether `u` means the same at every picture size, so that the published code, where it does not, has another
    /// value for it: the filter of the profile `paper`.
    pub sizeless: bool,
    /// Most frames that its policy lets pass without the detector while objects are followed.
    pub longest_pause: Option<u32>,
    /// Whether some of its skipped frames are looked at afterwards.
    pub audited: bool,
}

/// The last picture received, still encoded.
#[derive(Clone, Debug, PartialEq)]
pub struct LatestFrame {
    /// Sequence number of the frame.
    pub seq: u64,
    /// The picture; a cheap clone of what was received.
    pub picture: EncodedPicture,
}

/// The state of one camera; all numbers are of the same moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraSnapshot {
    /// Frame states since the node started.
    pub states: FrameStates,
    /// Frames answered from prediction because the detector was not available.
    pub degraded_frames: u64,
    /// Frames that the detector was called for, by cause.
    pub calls: DetectorCalls,
    /// Frames not processed, by kind.
    pub dropped: DroppedFrames,
    /// Frames of which a small grey picture was looked at, to follow boxes by optical flow.
    pub looks: u64,
    /// What the audit has found.
    pub audit: AuditCount,
    /// Joules of the audit in the clips that ended.
    pub audit_joules: f64,
    /// Clips ended.
    pub clips: u64,
    /// Energy of these clips, joules, over the time that samples cover.
    pub clip_joules: f64,
    /// Boxes reported, by class and how each is known.
    pub boxes: BTreeMap<(Arc<str>, &'static str), u64>,
    /// What was published for the newest frame.
    pub latest: Option<Arc<DetectionsMessage>>,
    /// Time since the newest frame was processed.
    pub last_frame_age: Option<Duration>,
    /// Frames that came in memory which their sender shares.
    pub shared_frames: u64,
    /// Messages about it that did not go out.
    pub unpublished: u64,
    /// Suggested value if nothing is skipped although objects are tracked.
    pub advice: Option<Advice>,
}

impl CameraSnapshot {
    /// Share of frames that skipped the detector, degraded ones not among them.
    pub fn skip_rate(&self) -> f64 {
        self.states.skip_rate(self.degraded_frames)
    }
}

/// A camera's work, as the target needs it.
#[derive(Clone, Debug, Default)]
pub(crate) struct CameraWork {
    /// Frames since the start.
    pub frames: u64,
    /// Those of them that skipped the detector.
    pub skipped: u64,
    /// Those for which the detector was not available.
    pub degraded: u64,
    /// Time the detector worked for them, microseconds.
    pub detector_us: u64,
    /// What was audited since this was asked last.
    pub audit: AuditSums,
}

#[derive(Debug, Default)]
struct Counts {
    /// What is shown of them; what is known elsewhere is added when it is asked for.
    shown: CameraSnapshot,
    /// What of the audit the target has not heard of.
    untold_audit: AuditSums,
    /// Time the detector worked for frames, microseconds.
    detector_us: u64,
    last_frame: Option<Instant>,
    watch: SkipWatch,
}

impl Counts {
    fn count_boxes(&mut self, boxes: &[BoxMessage]) {
        for one in boxes {
            let source = source_name(one.source);
            // A class is seen thousands of times: its name is copied the first time only.
            let known = (self.shown.boxes.iter_mut())
                .find(|((class, known), _)| **class == *one.class && *known == source);
            match known {
                Some((_, count)) => *count += 1,
                None => {
                    let key = (one.class.as_str().into(), source);
                    self.shown.boxes.insert(key, 1);
                }
            }
        }
    }
}

const fn source_name(source: BoxSource) -> &'static str {
    match source {
        BoxSource::Detected => "detected",
        BoxSource::Predicted => "predicted",
        BoxSource::Followed => "followed",
        BoxSource::Rescued => "rescued",
    }
}

/// One camera's part of the live board. The counters are behind one lock, so that any snapshot adds up.
#[derive(Debug)]
pub struct CameraBoard {
    name: Arc<str>,
    setup: CameraSetup,
    policy: &'static str,
    configured: Option<f64>,
    threshold: watch::Sender<Option<f64>>,
    /// Makes changes of the threshold that are kept one at a time, so that file, loop and events see the same order.
    /// Held while a disk is written: no async worker takes it.
    changing: Mutex<()>,
    /// Makes threshold events one at a time, so that the last one has the value in force.
    announcing: Mutex<()>,
    counts: Mutex<Counts>,
    /// The node's start: times of the past are counted from there.
    started: Instant,
    target: Arc<NodeTarget>,
    history: Mutex<History>,
    latest_frame: Mutex<Option<LatestFrame>>,
    shared_frames: AtomicU64,
    unpublished: Counter,
    total_latency: [Histogram; 5],
    detector_latency: Histogram,
    events: broadcast::Sender<SharedEvent>,
    outbox: Outbox,
    source: Mutex<SettingSource>,
}

impl CameraBoard {
    pub(super) fn new(
        setup: CameraSetup,
        policy: &'static str,
        started: Instant,
        events: broadcast::Sender<SharedEvent>,
        outbox: Outbox,
        target: Arc<NodeTarget>,
    ) -> Self {
        let configured = setup.knob.map(|knob| {
            let value = setup.threshold.unwrap_or(knob.default);
            knob.check(value).unwrap_or_else(|error| {
                tracing::error!(camera = setup.name, %error, "configured threshold not used");
                knob.default
            })
        });
        let kept = setup.knob.zip(configured).and_then(|(knob, configured)| {
            let (value, source) = thresholds::kept(&outbox, &setup.name, &knob, configured)?;
            tracing::info!(
                camera = setup.name,
                knob = knob.name,
                value,
                configured,
                "threshold taken over from the last run"
            );
            Some((value, source))
        });
        Self {
            name: setup.name.as_str().into(),
            setup,
            policy,
            configured,
            threshold: watch::Sender::new(kept.map(|(value, _)| value).or(configured)),
            source: Mutex::new(kept.map_or(SettingSource::Configuration, |(_, source)| source)),
            changing: Mutex::default(),
            announcing: Mutex::default(),
            counts: Mutex::default(),
            started,
            target,
            history: Mutex::default(),
            latest_frame: Mutex::default(),
            shared_frames: AtomicU64::new(0),
            unpublished: Counter::default(),
            total_latency: std::array::from_fn(|_| Histogram::new(LATENCY_BUCKETS_S)),
            detector_latency: Histogram::new(LATENCY_BUCKETS_S),
            events,
            outbox,
        }
    }

    /// The camera's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Zenoh key its frames come on, unless it has a source.
    pub fn key(&self) -> &str {
        &self.setup.key
    }

    /// The source that the node opens for it, without credentials.
    pub(crate) fn source(&self) -> Option<&str> {
        self.setup.source.as_deref()
    }

    /// Name of its policy.
    pub(crate) fn policy(&self) -> &'static str {
        self.policy
    }

    /// What the policy lets a user turn.
    pub fn knob(&self) -> Option<Knob> {
        self.setup.knob
    }

    /// Whether some of its skipped frames are looked at afterwards.
    pub(crate) fn audit_is_on(&self) -> bool {
        self.setup.audited
    }

    /// What the audit has found since the node started.
    pub(crate) fn audit(&self) -> AuditCount {
        self.counts.lock().shown.audit.clone()
    }

    /// Adds what the audit has found.
    pub(crate) fn record_audit(&self, more: &AuditCount) {
        let mut counts = self.counts.lock();
        counts.shown.audit.merge(more);
        counts.untold_audit.merge(&more.sums);
    }

    /// What the target needs: sums since the start, and of the audit what was not taken before.
    pub(crate) fn take_work(&self) -> CameraWork {
        let mut counts = self.counts.lock();
        let CameraSnapshot {
            states,
            degraded_frames,
            ..
        } = counts.shown;
        CameraWork {
            frames: states.frames(),
            skipped: states.skipped(degraded_frames),
            degraded: degraded_frames,
            detector_us: counts.detector_us,
            audit: std::mem::take(&mut counts.untold_audit),
        }
    }

    /// Counts a frame with its final answer.
    pub fn record_frame(&self, frame: &FrameRecord) {
        let detections = &frame.detections;
        let index = FrameState::ALL
            .iter()
            .position(|state| *state == detections.state);
        if let Some(histogram) = index.and_then(|index| self.total_latency.get(index)) {
            histogram.observe(frame.first_answer.as_secs_f64());
        }
        if let Some(detector) = detections.latency_ms.detector {
            self.detector_latency.observe(detector / 1e3);
        }
        let used = frame
            .times
            .detector_run
            .map_or(0, |run| run.used.as_micros());
        let mut counts = self.counts.lock();
        counts.shown.states.count(detections.state);
        counts.shown.degraded_frames += u64::from(detections.degraded);
        counts.shown.looks += u64::from(frame.times.examined);
        counts.detector_us =
            (counts.detector_us).saturating_add(used.try_into().unwrap_or(u64::MAX));
        counts.count_boxes(&detections.boxes);
        if let Some(cause) = detections.cause {
            counts.shown.calls.count(cause);
        }
        let clear = counts.watch.count(detections);
        let advice = clear.then(|| self.advice(&counts)).flatten();
        drop(counts);
        let at = self.started.elapsed();
        self.history.lock().add(detections, at);
        if let Some(advice) = advice {
            tracing::warn!(camera = %self.name, "{advice}");
        }
    }

    /// Sends the answer of a frame, which may be pending, to subscribers.
    pub fn show(&self, detections: Arc<DetectionsMessage>) {
        let mut counts = self.counts.lock();
        counts.last_frame = Some(Instant::now());
        let first = counts
            .shown
            .latest
            .replace(Arc::clone(&detections))
            .is_none();
        drop(counts);
        if first {
            self.tell_first_frame(&detections);
        }
        self.send_event(Event::Frame, detections);
    }

    /// Sends the final answer of a frame that was pending.
    pub(crate) fn show_late(&self, detections: Arc<DetectionsMessage>) {
        self.send_event(Event::Late, detections);
    }

    fn send_event(&self, kind: fn(FrameEvent) -> Event, detections: Arc<DetectionsMessage>) {
        if self.events.receiver_count() > 0 {
            let event = kind(FrameEvent {
                camera: Arc::clone(&self.name),
                detections,
            });
            let _ = self.events.send(event.into());
        }
    }

    fn advice(&self, counts: &Counts) -> Option<Advice> {
        counts.watch.advice(self.setup.knob.as_ref()?)
    }

    fn tell_first_frame(&self, first: &DetectionsMessage) {
        let picture = PictureSize::new(first.width, first.height);
        let published = self.published_threshold(picture);
        tracing::info!(
            camera = %self.name,
            from = self.source().unwrap_or(self.key()),
            picture = %picture,
            threshold = first.threshold.map(|threshold| threshold.to_string()),
            as_published = published.map(short),
            "first frame"
        );
    }

    /// The equivalent of `u` in the published code, in pictures of this size, where that is another
    /// number, to three digits.
    pub(crate) fn published_threshold(&self, picture: PictureSize) -> Option<f64> {
        let CameraSetup { knob, sizeless, .. } = self.setup;
        let knob = knob.filter(|knob| sizeless && knob.name == "u")?;
        let in_force = self
            .threshold()
            .filter(|value| knob.check(*value).is_ok())?;
        let published = published_threshold(in_force, picture);
        let rounded = format!("{published:.2e}").parse().unwrap_or(published);
        (rounded != in_force).then_some(rounded)
    }

    /// Counts a frame that came in memory which its sender shares.
    pub(crate) fn count_shared_frame(&self) {
        self.shared_frames.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts the messages about it that did not go out; clones are the same counter.
    pub(crate) fn unpublished(&self) -> Counter {
        self.unpublished.clone()
    }

    /// Adds frames that were not processed, each kind under its own name.
    pub fn record_dropped(&self, more: &DroppedFrames) {
        self.counts.lock().shown.dropped += more;
    }

    /// Counts a clip that ended, and its energy where it has a figure.
    pub(super) fn count_clip(&self, joules: Option<f64>, audit_joules: Option<f64>) {
        let shown = &mut self.counts.lock().shown;
        let known = |joules: Option<f64>| joules.filter(|joules| *joules > 0.0).unwrap_or_default();
        shown.clips += 1;
        shown.audit_joules += known(audit_joules);
        shown.clip_joules += known(joules);
    }

    /// The camera's state.
    pub fn snapshot(&self) -> CameraSnapshot {
        let counts = self.counts.lock();
        CameraSnapshot {
            last_frame_age: counts.last_frame.map(|instant| instant.elapsed()),
            shared_frames: self.shared_frames.load(Ordering::Relaxed),
            unpublished: self.unpublished.get(),
            advice: self.advice(&counts),
            ..counts.shown.clone()
        }
    }

    /// The last `frames` frames, oldest first, and the pieces of the last hour. Times are counted from the
    /// node's start, whose age is given with them.
    pub(crate) fn past(&self, frames: usize) -> (Vec<PastFrame>, Vec<PastSlot>, Duration) {
        let history = self.history.lock();
        let now = self.started.elapsed();
        (history.frames(frames), history.slots(now), now)
    }

    /// What other thresholds would have skipped over the last frames.
    pub(crate) fn skip_estimate(&self) -> SkipEstimate {
        let frames = self.history.lock().frames(usize::MAX);
        // After the lock: this takes longer than a frame may wait.
        SkipEstimate::new(&frames, self.setup.longest_pause)
    }

    /// Time from reception to publication of the frames with `state`.
    pub(crate) fn total_latency(&self, state: FrameState) -> &Histogram {
        let [e, p, ei, i, ai] = &self.total_latency;
        match state {
            FrameState::E => e,
            FrameState::P => p,
            FrameState::EI => ei,
            FrameState::I => i,
            FrameState::AI => ai,
        }
    }

    /// Time the detector took, over the frames where it ran.
    pub(crate) fn detector_latency(&self) -> &Histogram {
        &self.detector_latency
    }

    /// Keeps the newest picture for who wants to look.
    pub fn set_latest_frame(&self, frame: LatestFrame) {
        *self.latest_frame.lock() = Some(frame);
    }

    /// The newest picture.
    pub(crate) fn latest_frame(&self) -> Option<LatestFrame> {
        self.latest_frame.lock().clone()
    }

    /// The threshold in force from the next frame on; `None` when the policy has none.
    pub fn threshold(&self) -> Option<f64> {
        *self.threshold.borrow()
    }

    /// The same with its name.
    pub(crate) fn threshold_in_force(&self) -> Option<Threshold> {
        Some(Threshold::new(self.setup.knob?.name, self.threshold()?))
    }

    /// Who set the threshold in force.
    pub(crate) fn threshold_source(&self) -> SettingSource {
        *self.source.lock()
    }

    /// The threshold, for the camera's loop: read it before each frame.
    pub fn watch_threshold(&self) -> watch::Receiver<Option<f64>> {
        self.threshold.subscribe()
    }

    /// The threshold in force as an event.
    pub(super) fn threshold_event(&self) -> Option<Event> {
        Some(Event::Threshold(ThresholdEvent {
            camera: Arc::clone(&self.name),
            threshold: self.threshold_in_force()?,
        }))
    }

    /// Sends the threshold in force to subscribers.
    fn announce_threshold(&self) {
        let _announcing = self.announcing.lock();
        if let Some(event) = self.threshold_event() {
            let _ = self.events.send(event.into());
        }
    }

    /// Checks a value without using it.
    ///
    /// # Errors
    /// [`KnobError`] when the policy has no knob or the value is outside its range.
    pub(crate) fn check_threshold(&self, value: f64) -> Result<Knob, KnobError> {
        let knob = self.setup.knob.ok_or(KnobError::Absent {
            policy: self.policy,
        })?;
        knob.check(value)?;
        Ok(knob)
    }

    /// Changes the threshold from the next frame on, keeps it in the state directory and announces it. When it cannot be
    /// kept the change still holds, and the log and [`Board::thresholds_are_kept`](super::Board::thresholds_are_kept) say
    /// so. Writes a small file.
    ///
    /// # Errors
    /// [`KnobError`] when the policy has no threshold or the value is outside its range; nothing changes then.
    pub(crate) fn set_threshold(&self, value: f64, source: SettingSource) -> Result<(), KnobError> {
        let knob = self.check_threshold(value)?;
        // First, so that the controller moves nothing any more.
        self.target.turned_by_hand(source);
        let changing = self.changing.lock();
        let before = self.threshold.send_replace(Some(value));
        *self.source.lock() = source;
        if let Some(configured) = self.configured {
            thresholds::keep(&self.outbox, &self.name, &knob, configured, value, source);
        }
        self.announce_threshold();
        drop(changing);
        tracing::info!(camera = %self.name, knob = knob.name, ?before, now = value, "threshold changed");
        Ok(())
    }

    /// Moves the threshold on behalf of the node's target: it holds from the next frame on, and nothing is kept. A value
    /// that the knob cannot have changes nothing.
    pub(crate) fn move_threshold(&self, value: f64) {
        let Ok(knob) = self.check_threshold(value) else {
            return;
        };
        let before = self.threshold.send_replace(Some(value));
        self.announce_threshold();
        tracing::debug!(camera = %self.name, knob = knob.name, ?before, now = value, "threshold moved");
    }
}
