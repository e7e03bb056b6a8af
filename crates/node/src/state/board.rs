//! The live board: what the camera loops write while they run, and what HTTP, metrics and the counter
//! messages read. Nothing here decides anything.

mod camera;
mod event;
mod history;
mod savings;
mod setup;
mod threshold;

pub use camera::CameraSnapshot;
pub use camera::{CameraBoard, CameraSetup, LatestFrame};
pub use event::{Event, FrameEvent, SharedEvent, ThresholdEvent};
pub(crate) use history::{CameraSlot, Clock, FRAMES, PastFrame, PowerPiece, SLOT_S};
pub(crate) use savings::{Savings, Totals};
pub use setup::SetupError;
pub use setup::{BoardSetup, DetectorFacts};
pub use threshold::ThresholdError;
#[cfg(test)]
pub(crate) use threshold::set_by_hand;
pub(crate) use threshold::set_thresholds;

use crate::delivery::outbox::Outbox;
use crate::state::readiness;
use crate::state::target::NodeTarget;
use albireo_core::target::{Target, TargetError};
pub use albireo_power::PowerSnapshot;
use albireo_service::clock::unix_milliseconds;
use albireo_service::readiness::{Fault, Readiness};
use albireo_service::supervise::TaskTally;
use albireo_vision::detector::{DetectorCounts, DetectorMeter, DetectorStatus};
use albireo_vision::worker::{WorkerCounts, WorkerMeter};
use albireo_wire::{ClipReport, CountersMessage, SettingSource};
use camera::Shared;
use history::PowerPast;
use parking_lot::Mutex;
use savings::Today;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::{broadcast, watch};
use tokio::time::Instant;
use uuid::Uuid;

/// Clip reports kept for readers; older ones are forgotten.
pub(crate) const RECENT_CLIPS: usize = 256;

/// Events a slow reader may be behind before it loses some (and learns how many).
const EVENT_BACKLOG: usize = 1024;

/// The live board of one node. Shared by `Arc`; every method takes `&self` and never blocks for long.
#[derive(Debug)]
pub struct Board {
    node: String,
    policy: &'static str,
    started: Instant,
    cameras: Vec<Arc<CameraBoard>>,
    clips: Mutex<VecDeque<Arc<ClipReport>>>,
    events: broadcast::Sender<SharedEvent>,
    detector: DetectorFacts,
    detector_status: watch::Receiver<DetectorStatus>,
    meters: OnceLock<(DetectorMeter, Option<WorkerMeter>)>,
    power: Mutex<PowerPast>,
    started_ms: i64,
    today: Mutex<Today>,
    readiness: Readiness,
    tasks: TaskTally,
    outbox: Outbox,
    target: Arc<NodeTarget>,
}

impl Board {
    /// A board with no frames yet. Thresholds kept in the state directory by an earlier run are taken over where
    /// the policy's knob still has that name and range and the configured value is the same as then; a
    /// file that cannot be read is logged and otherwise ignored. Call inside a tokio runtime or not, as
    /// you like.
    pub fn new(setup: BoardSetup) -> Arc<Self> {
        let (events, _) = broadcast::channel(EVENT_BACKLOG);
        let started = Instant::now();
        let begin = setup.cameras.first().and_then(|camera| camera.threshold);
        let target = NodeTarget::open(setup.target, setup.outbox.clone(), begin);
        let target = Arc::new(target);
        let shared = Shared {
            policy: setup.policy,
            started,
            events: events.clone(),
            outbox: setup.outbox.clone(),
            target: Arc::clone(&target),
        };
        let cameras = setup.cameras.into_iter();
        let cameras = cameras.map(|camera| Arc::new(CameraBoard::new(camera, shared.clone())));
        let started_ms = unix_milliseconds();
        let readiness = Readiness::default();
        let detector_status = setup.detector_status.clone();
        readiness.probe(readiness::DETECTOR, "", move || {
            readiness::of_detector(&detector_status.borrow())
        });
        let outbox = setup.outbox.clone();
        readiness.probe(readiness::DISK, "", move || {
            outbox.counts().failing.map(Fault::degraded)
        });
        let outbox = setup.outbox.clone();
        readiness.probe(readiness::OUTBOX, "", move || {
            readiness::of_outbox(&outbox.counts(), outbox.has_directory())
        });
        Arc::new(Self {
            node: setup.node,
            policy: setup.policy,
            started,
            cameras: cameras.collect(),
            clips: Mutex::default(),
            events,
            detector: setup.detector,
            detector_status: setup.detector_status,
            meters: OnceLock::new(),
            power: Mutex::default(),
            started_ms,
            today: Mutex::new(Today {
                since_ms: started_ms,
                before: Totals::default(),
            }),
            readiness,
            tasks: TaskTally::default(),
            outbox: setup.outbox,
            target,
        })
    }

    /// The node's name.
    pub fn node(&self) -> &str {
        &self.node
    }

    /// The policy's name.
    pub fn policy(&self) -> &'static str {
        self.policy
    }

    /// Where to read what the detector and the screen count, once they have started. The first ones stay.
    pub(crate) fn attach_meters(&self, detector: DetectorMeter, screen: Option<WorkerMeter>) {
        let _ = self.meters.set((detector, screen));
    }

    /// What the detector has counted; all 0 before it has started.
    pub(crate) fn detector_counters(&self) -> DetectorCounts {
        let detector = self.meters.get().map(|(detector, _)| detector.read());
        detector.unwrap_or_default()
    }

    /// What the screen has counted; all 0 before it has started, and where there is none.
    pub(crate) fn screen_counters(&self) -> WorkerCounts {
        let screen = self.meters.get().and_then(|(_, screen)| screen.as_ref());
        screen.map(WorkerMeter::read).unwrap_or_default()
    }

    /// Time since the board was made.
    pub(crate) fn uptime(&self) -> Duration {
        self.started.elapsed()
    }

    /// All cameras, in the order of the configuration.
    pub fn cameras(&self) -> &[Arc<CameraBoard>] {
        &self.cameras
    }

    /// The camera of that name.
    pub fn camera(&self, name: &str) -> Option<&Arc<CameraBoard>> {
        self.cameras.iter().find(|camera| camera.name() == name)
    }

    /// What happens from now on. A reader that falls more than 1024 events behind gets
    /// `RecvError::Lagged` with the number it lost.
    pub fn subscribe(&self) -> broadcast::Receiver<SharedEvent> {
        self.events.subscribe()
    }

    /// Keeps a clip's report, counts it for its camera and sends it to subscribers.
    pub fn record_clip(&self, report: ClipReport) {
        if let Some(camera) = self.camera(&report.camera) {
            let audit_joules = report.audit.as_ref().and_then(|audit| audit.joules);
            camera.count_clip(report.energy.joules, audit_joules);
        }
        let report = Arc::new(report);
        let mut clips = self.clips.lock();
        if clips.len() == RECENT_CLIPS {
            clips.pop_front();
        }
        clips.push_back(Arc::clone(&report));
        drop(clips);
        // An error only means that there are no subscribers.
        let _ = self.events.send(Event::Clip(report).into());
    }

    /// The newest clip reports, newest first: of one camera or of all, at most `limit`.
    pub fn recent_clips(&self, camera: Option<&str>, limit: usize) -> Vec<Arc<ClipReport>> {
        self.clips_between(camera, None, None, limit)
    }

    /// The newest clip reports, newest first: of one camera or of all, at most `limit`; those older than `before` and newer
    /// than `after`. Of reports that are not in memory nothing is older, and all are newer.
    pub(crate) fn clips_between(
        &self,
        camera: Option<&str>,
        before: Option<Uuid>,
        after: Option<Uuid>,
        limit: usize,
    ) -> Vec<Arc<ClipReport>> {
        let clips = self.clips.lock();
        let mut newest_first = clips.iter().rev();
        if let Some(before) = before {
            newest_first.by_ref().find(|report| report.id == before);
        }
        newest_first
            .take_while(|report| Some(report.id) != after)
            .filter(|report| camera.is_none_or(|name| report.camera == name))
            .take(limit)
            .cloned()
            .collect()
    }

    /// The present counter messages of all cameras, sent to subscribers too. To be called
    /// once a second; `t_ns` is the wall clock, nanoseconds since the Unix epoch.
    pub fn publish_counters(&self, t_ns: u64) -> Vec<Arc<CountersMessage>> {
        self.turn_day();
        self.cameras
            .iter()
            .map(|camera| {
                let message = Arc::new(self.counters(camera, t_ns));
                let _ = (self.events).send(Event::Counters(Arc::clone(&message)).into());
                message
            })
            .collect()
    }

    /// The present state as events: thresholds and counters of every camera.
    pub(crate) fn current(&self, t_ns: u64) -> Vec<Event> {
        let thresholds = |camera: &Arc<CameraBoard>| {
            let counters = Event::Counters(Arc::new(self.counters(camera, t_ns)));
            camera.threshold_event().into_iter().chain([counters])
        };
        self.cameras.iter().flat_map(thresholds).collect()
    }

    /// The present counter message of one camera.
    pub fn counters(&self, camera: &CameraBoard, t_ns: u64) -> CountersMessage {
        let snapshot = camera.snapshot();
        let power = self.power();
        CountersMessage {
            v: albireo_wire::VERSION,
            t_ns,
            camera: camera.name().to_owned(),
            frames: snapshot.states.frames(),
            states: snapshot.states,
            skip_rate: snapshot.skip_rate(),
            degraded_frames: snapshot.degraded_frames,
            calls: snapshot.calls,
            dropped: snapshot.dropped,
            threshold: camera.threshold_in_force(),
            watts: power.watts,
            power_quality: power.quality,
            target: self.target.is_on().then(|| self.target.report()),
            audit: camera.audit_is_on().then(|| snapshot.audit.figures()),
        }
    }

    /// Holds `target` from now on, or nothing: the knob then stays where it is, and is kept there. Writes small files.
    ///
    /// # Errors
    /// [`TargetError`] when it cannot be held; nothing changes then.
    pub(crate) fn set_target(
        &self,
        target: Option<Target>,
        source: SettingSource,
    ) -> Result<(), TargetError> {
        let has_target = self.target.is_on();
        let knob = self.cameras.first().and_then(|camera| camera.threshold());
        self.target.set(target, knob, source)?;
        if has_target && target.is_none() {
            for camera in &self.cameras {
                camera.keep_threshold(source);
            }
        }
        Ok(())
    }

    /// The target, which moves the thresholds while one is set.
    pub(crate) fn target(&self) -> &NodeTarget {
        &self.target
    }

    /// Whether the thresholds in force will still hold after a restart: a `state_dir` is set and the
    /// last write to it went well.
    pub(crate) fn thresholds_are_kept(&self) -> bool {
        self.outbox.keeps_settings()
    }

    /// Where reports wait for a hub, and what must survive.
    pub(crate) fn outbox(&self) -> &Outbox {
        &self.outbox
    }

    /// What was known about the detector before it started.
    pub(crate) fn detector_facts(&self) -> &DetectorFacts {
        &self.detector
    }

    /// How the detector is doing now.
    pub(crate) fn detector_status(&self) -> DetectorStatus {
        self.detector_status.borrow().clone()
    }

    /// How the detector is doing, to wait for changes.
    pub(crate) fn watch_detector(&self) -> watch::Receiver<DetectorStatus> {
        self.detector_status.clone()
    }

    /// Writes the power figures; to be called by the sampling task.
    pub fn set_power(&self, power: PowerSnapshot) {
        self.power.lock().add(power, self.uptime());
    }

    /// Power over the last hour, oldest first.
    pub(crate) fn power_past(&self) -> Vec<PowerPiece> {
        let now = Clock {
            now_ms: unix_milliseconds(),
            age: self.uptime(),
        };
        self.power.lock().slots(&now)
    }

    /// What was counted since the start, with power as it is there.
    pub(crate) fn totals(&self, power: &PowerSnapshot) -> Totals {
        let total = |sums: &BTreeMap<String, f64>| sums.get("total").copied().unwrap_or_default();
        let mut totals = Totals {
            joules: total(&power.joules),
            covered_s: total(&power.covered_s),
            sampled_s: power.sampled_s,
            saved_detector_s: power.saved_detector_s,
            ..Totals::default()
        };
        for camera in &self.cameras {
            let snapshot = camera.snapshot();
            totals.frames += snapshot.states.frames();
            totals.skipped += snapshot.states.skipped(snapshot.degraded_frames);
            totals.degraded += snapshot.degraded_frames;
            totals.detector_us += snapshot.detector_us;
        }
        totals
    }

    fn turn_day(&self) {
        let so_far = || self.totals(&self.power());
        self.today.lock().turn(unix_milliseconds(), so_far);
    }

    /// What was saved since the start, and today.
    pub(crate) fn savings(&self) -> (Savings, Savings) {
        self.turn_day();
        let power = self.power();
        let now = self.totals(&power);
        let today = self.today.lock();
        let of_today = (now - today.before).savings(today.since_ms, &power);
        (now.savings(self.started_ms, &power), of_today)
    }

    /// The power figures as last written.
    pub fn power(&self) -> PowerSnapshot {
        self.power.lock().newest().clone()
    }

    /// Whether the node works, part by part.
    pub fn readiness(&self) -> &Readiness {
        &self.readiness
    }

    /// How often the node's tasks failed.
    pub fn tasks(&self) -> &TaskTally {
        &self.tasks
    }
}

#[cfg(test)]
pub(crate) mod tests;
