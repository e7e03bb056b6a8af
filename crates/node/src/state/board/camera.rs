//! One camera's part of the live board.

use super::CHANGES_PERIOD;
use super::event::{Event, FrameEvent, News};
use super::flow::Flow;
use super::history::{CameraPiece, Clock, History, PastFrame, SkipEstimate};
use super::policy::NodePolicy;
use super::screen::NoNews;
use super::sightings::{ClassWatch, SightingsConfig};
use super::threshold::InForce;
use crate::frame::{AnsweredFrame, FrameRecord};
use crate::input::{ArrivalCounts, InputCounter, Unusable};
use crate::publishing::Unpublished;
use crate::state::advice::{Advice, SkipWatch};
use albireo_core::audit::AuditSums;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{BoxSource, EmptyRoad, short};
use albireo_service::metrics::LatencyHistogram;
use albireo_service::rate_limit::RateLimit;
use albireo_vision::picture::EncodedPicture;
use albireo_wire::{
    AuditReport, BoxMessage, CameraKeys, DetectionsMessage, DetectorCalls, DroppedFrames,
    FrameStates, SettingSource, Sighting, Threshold,
};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;
use tokio::sync::{broadcast, watch};
use tokio::time::Instant;

/// What was counted since the last report and belongs to the open clip.
pub(crate) struct UnreportedCounts {
    /// Frames that were not processed.
    pub dropped: DroppedFrames,
    /// Audit results.
    pub audit: AuditReport,
}

/// The state of one camera. The numbers of its loop are from the same moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraSnapshot {
    /// Frame states since the node started.
    pub states: FrameStates,
    /// Frames answered from prediction because the detector was not available.
    pub degraded_frames: u64,
    /// Frames for which the detector was called, by cause.
    pub calls: DetectorCalls,
    /// Frames that a pause passed over, by cause in the order of `PassCause::ALL`.
    pub passed: [u64; 3],
    /// Unprocessed frames, by kind.
    pub dropped: DroppedFrames,
    /// The audit's results; `None` without an audit.
    pub audit: Option<AuditReport>,
    /// The same, since the policy was last switched.
    pub policy_audit: Option<AuditReport>,
    /// Ended clips.
    pub clips: u64,
    /// Energy of these clips, joules, over the time that samples cover.
    pub clip_joules: f64,
    /// Detector time used for its frames, microseconds.
    pub detector_us: u64,
    /// Reported boxes, by class and origin.
    pub boxes: BTreeMap<(Arc<str>, &'static str), u64>,
    /// Time from reception to publication, by frame state in the order of `FrameState::ALL`.
    pub total_latency: [LatencyHistogram; 5],
    /// Detector time, for the frames on which it ran.
    pub detector_latency: LatencyHistogram,
    /// The message published for the newest frame.
    pub latest: Option<Arc<DetectionsMessage>>,
    /// The time of the newest frame's answer.
    pub last_frame: Option<Instant>,
    /// Messages about it that were not published.
    pub unpublished: u64,
    /// The last frames, if they were no usable pictures.
    pub unusable: Unusable,
    /// What the camera has sent.
    pub arrived: ArrivalCounts,
    /// The frames per second that come, over the last ten seconds; `None` in the first.
    pub rate: Option<f64>,
    /// What is wrong with the frames of the last ten seconds.
    pub flow_fault: Option<Arc<str>>,
}

/// The least time between two log lines about pictures without news.
const NEWS_PERIOD: Duration = Duration::from_secs(60);

/// So many unusable frames in a row are a fault of the camera, and not of a frame.
const UNUSABLE_IN_A_ROW: u64 = 5;

impl CameraSnapshot {
    /// The share of frames that skipped the detector, without degraded ones.
    pub fn skip_rate(&self) -> f64 {
        self.states.skip_rate(self.degraded_frames)
    }

    /// The time since the newest frame was answered.
    pub fn last_frame_age(&self) -> Option<Duration> {
        Some(self.last_frame?.elapsed())
    }

    /// The fault of the camera's frames, if the last of them were all unusable.
    pub fn unusable(&self) -> Option<String> {
        let Unusable { frames, fault } = &self.unusable;
        if *frames < UNUSABLE_IN_A_ROW {
            return None;
        }
        Some(format!(
            "its last {frames} frames could not be used: {fault}"
        ))
    }

    /// What is wrong with the flow of its frames.
    pub fn flow_fault(&self) -> Option<String> {
        self.flow_fault.as_deref().map(str::to_owned)
    }

    /// Counts a frame with its final answer.
    fn count(&mut self, frame: &FrameRecord) {
        let detections = &frame.detections;
        let times = &mut self.total_latency[detections.state as usize];
        times.observe(frame.first_answer.as_secs_f64());
        if let Some(detector) = detections.latency_ms.detector {
            self.detector_latency.observe(detector / 1e3);
        }
        if let Some(run) = frame.times.detector_run {
            self.detector_us += run.used.as_micros() as u64;
        }
        self.states.count(detections.state);
        self.degraded_frames += u64::from(detections.degraded);
        self.count_boxes(&detections.boxes);
        if let Some(cause) = detections.cause {
            self.calls.count(cause);
        }
        if let Some(cause) = detections.passed {
            self.passed[cause as usize] += 1;
        }
    }

    fn count_boxes(&mut self, boxes: &[BoxMessage]) {
        for one in boxes {
            let source = source_name(one.source);
            // A class occurs thousands of times: copies its name only the first time.
            let known = self
                .boxes
                .iter_mut()
                .find(|((class, known), _)| **class == *one.class && *known == source);
            match known {
                Some((_, count)) => *count += 1,
                None => {
                    self.boxes.insert((one.class.as_str().into(), source), 1);
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

#[derive(Debug, Default)]
pub(super) struct Counts {
    /// The counts that are shown, without those that others keep.
    shown: CameraSnapshot,
    /// Audit results that are in no clip yet.
    unreported: AuditReport,
    /// Audit results that the target has not used yet.
    unmeasured: AuditSums,
    watch: SkipWatch,
    flow: Flow,
}

impl Counts {
    /// Forgets what was observed under another policy.
    pub(super) fn policy_begins(&mut self) {
        self.watch = SkipWatch::default();
        self.unmeasured = AuditSums::default();
        if let Some(audit) = &mut self.shown.policy_audit {
            *audit = AuditReport {
                share: audit.share,
                ..AuditReport::default()
            };
        }
    }
}

/// State that all cameras of a board share.
#[derive(Clone, Debug)]
pub(super) struct Shared {
    /// The node's name.
    pub node: Arc<str>,
    /// The node's start, from which times of the past are counted.
    pub started: Instant,
    pub events: broadcast::Sender<Arc<Event>>,
    pub sightings: broadcast::Sender<Arc<Sighting>>,
    /// The pause on an empty road.
    pub empty_road: watch::Sender<EmptyRoad>,
}

/// The past of a camera.
#[derive(Debug)]
pub(crate) struct CameraPast {
    /// The last frames, oldest first.
    pub frames: Vec<PastFrame>,
    /// The number of the last of them that the policy in force decided.
    pub of_policy: usize,
    /// The pieces of the last hour.
    pub pieces: Vec<CameraPiece>,
    /// The present time.
    pub now: Clock,
}

/// What the board of a camera shows that never changes, and its configured threshold.
#[derive(Debug)]
pub(crate) struct CameraSetup {
    /// The camera's name.
    pub name: String,
    /// Its Zenoh keys.
    pub keys: CameraKeys,
    /// The Zenoh key of its frames.
    pub key: String,
    /// The source that the node opens for it, without credentials.
    pub source: Option<String>,
    /// The most frames per second that are taken from its source.
    pub max_rate: Option<f64>,
    /// Its threshold, instead of the policy's.
    pub threshold: Option<f64>,
    /// True if its frames are answered at once.
    pub answers_at_once: bool,
    /// An audit without results; `None` without an audit.
    pub audit: Option<AuditReport>,
}

/// One camera's part of the live board. One lock guards the counters of the camera's loop, so every snapshot of them is
/// consistent.
#[derive(Debug)]
pub struct CameraBoard {
    pub(super) name: Arc<str>,
    /// Its Zenoh keys.
    pub(crate) keys: CameraKeys,
    /// The Zenoh key of its frames, unless it has a source.
    pub(crate) key: String,
    /// The source that the node opens for it, without credentials.
    pub(crate) source: Option<String>,
    /// The most frames per second that are taken from the source.
    pub(crate) max_rate: Option<f64>,
    /// True if its frames are answered at once.
    pub(crate) answers_at_once: bool,
    pub(super) shared: Shared,
    /// Its own threshold in the configuration, under its name in the configured policy.
    pub(super) own: Option<Threshold>,
    pub(super) in_force: watch::Sender<InForce>,
    pub(super) set_by: Mutex<SettingSource>,
    /// The bits of the measured frames per second; 0 before the second frame.
    pub(super) rate: AtomicU64,
    /// Whether its pictures have no news.
    pub(super) no_news: Mutex<Option<NoNews>>,
    /// Log lines about that: a picture may change every second.
    pub(super) news_changes: RateLimit,
    /// Counts the frames that do not reach its loop, and keeps its newest picture.
    pub input: Arc<InputCounter>,
    /// Counts the messages about it that were not published.
    pub(crate) unpublished: Unpublished,
    /// Log lines about its threshold.
    pub(super) changes: RateLimit,
    pub(super) counts: Mutex<Counts>,
    pub(super) history: Mutex<History>,
    /// The newest answered frame, for viewers of pictures with boxes.
    answered: watch::Sender<Option<Arc<AnsweredFrame>>>,
    /// Finds when a class appears and when it leaves.
    pub(super) classes: Mutex<ClassWatch>,
}

impl CameraBoard {
    /// Creates the board of a camera without frames, with the configured threshold in force.
    pub(super) fn new(
        setup: CameraSetup,
        policy: &Arc<NodePolicy>,
        sightings: SightingsConfig,
        shared: Shared,
    ) -> Self {
        let own = match (policy.spec, setup.threshold) {
            (Some(spec), Some(value)) => Some(Threshold::new(spec.name, value)),
            _ => None,
        };
        let in_force = InForce {
            policy: Arc::clone(policy),
            threshold: own.map(|own| own.value).or(policy.threshold),
        };
        let mut counts = Counts::default();
        counts.shown.audit.clone_from(&setup.audit);
        counts.shown.policy_audit = setup.audit;
        Self {
            name: setup.name.into(),
            keys: setup.keys,
            key: setup.key,
            source: setup.source,
            max_rate: setup.max_rate,
            answers_at_once: setup.answers_at_once,
            shared,
            own,
            in_force: watch::Sender::new(in_force),
            set_by: Mutex::new(SettingSource::Configuration),
            input: Arc::default(),
            unpublished: Unpublished::default(),
            changes: RateLimit::new(CHANGES_PERIOD),
            rate: AtomicU64::default(),
            no_news: Mutex::default(),
            news_changes: RateLimit::new(NEWS_PERIOD),
            counts: Mutex::new(counts),
            history: Mutex::default(),
            answered: watch::Sender::default(),
            classes: Mutex::new(ClassWatch::new(sightings)),
        }
    }

    /// The newest answered frame with its picture, now and whenever there is a newer one.
    pub(crate) fn answered(&self) -> watch::Receiver<Option<Arc<AnsweredFrame>>> {
        self.answered.subscribe()
    }

    /// The camera's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Adds audit results.
    pub(crate) fn record_audit(&self, more: &AuditReport) {
        let mut counts = self.counts.lock();
        let CameraSnapshot {
            audit,
            policy_audit,
            ..
        } = &mut counts.shown;
        for shown in audit.iter_mut().chain(policy_audit) {
            shown.merge(more);
        }
        counts.unreported.merge(more);
        counts.unmeasured.merge(&more.sums);
    }

    /// Takes the audit results since the last call.
    pub(crate) fn take_audit(&self) -> AuditSums {
        std::mem::take(&mut self.counts.lock().unmeasured)
    }

    /// Takes the dropped frames and audit results since the last call, for the open clip.
    pub(crate) fn take_unreported(&self) -> UnreportedCounts {
        let audit = std::mem::take(&mut self.counts.lock().unreported);
        UnreportedCounts {
            dropped: self.input.take_unreported(),
            audit,
        }
    }

    /// Counts a frame with its final answer.
    pub fn record_frame(&self, frame: &FrameRecord) {
        let mut counts = self.counts.lock();
        counts.shown.count(frame);
        let is_clear_now = counts.watch.count(&frame.detections);
        drop(counts);
        let at = self.shared.started.elapsed();
        self.history.lock().add(&frame.detections, at);
        if is_clear_now && let Some(advice) = self.advice() {
            tracing::warn!(camera = %self.name, "{advice}");
        }
    }

    /// Sends a frame's answer, which may be pending, to subscribers, and keeps its picture for viewers.
    pub fn show(&self, detections: Arc<DetectionsMessage>, picture: EncodedPicture) {
        let answered = AnsweredFrame::new(picture, Arc::clone(&detections));
        self.answered.send_replace(Some(Arc::new(answered)));
        let mut counts = self.counts.lock();
        counts.shown.last_frame = Some(Instant::now());
        let before = counts.shown.latest.replace(Arc::clone(&detections));
        drop(counts);
        self.input.answered();
        if before.is_none() {
            let picture = PictureSize::new(detections.width, detections.height);
            let published = self.published_threshold(picture);
            tracing::info!(
                camera = %self.name,
                from = self.source.as_deref().unwrap_or(&self.key),
                picture = %picture,
                threshold = detections.threshold.map(|threshold| threshold.to_string()),
                as_published = published.map(short),
                "first frame"
            );
        }
        self.send_event(News::Frame, Arc::clone(&detections));
        self.tell_sightings(&detections);
    }

    /// Sends the final answer of a pending frame.
    pub(crate) fn show_late(&self, detections: Arc<DetectionsMessage>) {
        self.send_event(News::Late, detections);
    }

    fn send_event(&self, kind: fn(FrameEvent) -> News, detections: Arc<DetectionsMessage>) {
        if self.shared.events.receiver_count() > 0 {
            let news = kind(FrameEvent {
                camera: Arc::clone(&self.name),
                detections,
            });
            let _ = self.shared.events.send(Event::new(news));
        }
    }

    /// Suggests a value of the threshold if nothing is skipped although objects are tracked.
    pub fn advice(&self) -> Option<Advice> {
        self.counts.lock().watch.advice(&self.threshold_spec()?)
    }

    /// Counts an ended clip, and its energy if known.
    pub(super) fn count_clip(&self, joules: Option<f64>) {
        let shown = &mut self.counts.lock().shown;
        shown.clips += 1;
        if let Some(joules) = joules
            && joules > 0.0
        {
            shown.clip_joules += joules;
        }
    }

    /// The camera's state.
    pub fn snapshot(&self) -> CameraSnapshot {
        let shown = self.counts.lock().shown.clone();
        let (dropped, unusable) = self.input.counts();
        CameraSnapshot {
            dropped,
            unusable,
            unpublished: self.unpublished.get(),
            arrived: self.input.arrivals.now(),
            ..shown
        }
    }

    /// Looks at how its frames flow. Call it once a second.
    pub(super) fn sample_flow(&self) {
        let arrivals = &self.input.arrivals;
        let arrived = arrivals.now();
        let complaint = arrivals.last_complaint();
        let (dropped, _) = self.input.counts();
        let Counts { shown, flow, .. } = &mut *self.counts.lock();
        flow.sample(Instant::now(), arrived, dropped);
        shown.rate = flow.rate();
        shown.flow_fault = flow.fault(complaint.as_deref()).map(Arc::from);
    }

    /// The last frames, at most `most`, and the last hour.
    pub(crate) fn past(&self, most: usize) -> CameraPast {
        let history = self.history.lock();
        let now = Clock::now(self.shared.started);
        CameraPast {
            frames: history.frames(most),
            of_policy: history.of_policy().min(most),
            pieces: history.slots(&now),
            now,
        }
    }

    /// Estimates what these values of the threshold would have skipped over the last frames. Computes for some
    /// milliseconds.
    pub(crate) fn skip_estimate(&self, values: &[f64]) -> Option<SkipEstimate> {
        let history = self.history.lock();
        let frames = history.frames(history.of_policy());
        drop(history);
        // Outside the lock: this takes longer than a frame may wait.
        let longest_pause = self.in_force.borrow().policy.longest_pause;
        SkipEstimate::of(&frames, longest_pause, values)
    }
}
