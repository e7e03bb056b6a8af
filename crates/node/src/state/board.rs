//! The live board, which camera loops write, and which HTTP, metrics and the counter messages read.

mod camera;
mod event;
mod flow;
mod forwarded;
mod history;
mod policy;
mod savings;
mod screen;
mod sightings;
mod threshold;

pub use camera::{CameraBoard, CameraSnapshot};
pub(crate) use camera::{CameraSetup, UnreportedCounts};
pub(crate) use event::provider;
pub use event::{DetectorEvent, Event, FrameEvent, News, ThresholdEvent};
pub(crate) use forwarded::{Forwarded, ForwardedCounts};
pub(crate) use history::{CameraPiece, Clock, FRAMES, PastFrame, PowerPiece, SLOT_S, SkipEstimate};
pub(crate) use policy::NodePolicy;
pub(crate) use savings::{Savings, Totals};
pub(crate) use screen::NoNews;
pub use sightings::SightingsConfig;
pub(crate) use threshold::InForce;

use crate::position::Positions;
use crate::state::readiness;
use crate::state::target::NodeTarget;
use albireo_core::policy::EmptyRoad;
pub use albireo_power::PowerSnapshot;
use albireo_service::clock::unix_milliseconds;
use albireo_service::identity::Certificates;
use albireo_service::readiness::{Fault, Readiness};
use albireo_service::supervise::TaskFailures;
use albireo_vision::detector::{
    EngineBuild, ExecutionProvider, HeadMeter, ModelStatus, PrecisionProof, Preparation,
};
use albireo_vision::worker::{WorkerCounts, WorkerMeter};
use albireo_wire::{AuditReport, ClipReport, CountersMessage};
use camera::Shared;
use history::PowerPast;
use parking_lot::Mutex;
use policy::Switched;
use savings::Today;
use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::{broadcast, watch};
use tokio::time::Instant;
use uuid::Uuid;

/// The number of clip reports kept for readers; older ones are dropped.
pub(crate) const RECENT_CLIPS: usize = 256;

/// The number of events a slow reader may lag before it loses some (and learns how many).
const EVENT_BACKLOG: usize = 1024;

/// The number of sightings that a slow reader may lag before it loses some (and learns how many).
const SIGHTING_BACKLOG: usize = 256;

/// The least time between two log lines about changes of one setting: whoever may change it could otherwise fill the log.
pub(super) const CHANGES_PERIOD: Duration = Duration::from_secs(1);

/// The live board of one node. Shared by `Arc`; every method takes `&self` and never blocks for long.
#[derive(Debug)]
pub struct Board {
    /// The node's name.
    pub(crate) node: String,
    /// File name of the detector's model.
    pub(crate) model: String,
    /// Requested execution providers, in order.
    pub(crate) providers: Vec<ExecutionProvider>,
    /// All cameras, in the order of the configuration.
    pub cameras: Vec<Arc<CameraBoard>>,
    /// Reports whether the node works, part by part.
    pub readiness: Readiness,
    /// Counts the failures of the node's tasks.
    pub tasks: TaskFailures,
    /// The certificates of its sessions.
    pub(crate) certificates: Certificates,
    /// Where the node is.
    pub(crate) positions: Arc<Positions>,
    /// The target, which moves the thresholds while one is set.
    pub(crate) target: NodeTarget,
    /// The policy in force.
    policy: Mutex<Arc<NodePolicy>>,
    configured_policy: Arc<NodePolicy>,
    /// The last switch of the policy, if there was one.
    switched: Mutex<Option<Switched>>,
    /// The pause on an empty road of the configuration.
    configured_road: EmptyRoad,
    shared: Shared,
    clips: Mutex<VecDeque<Arc<ClipReport>>>,
    detector: Arc<Mutex<ModelStatus>>,
    /// The meters of the detector and the screen, once these have started.
    pub(crate) meters: OnceLock<WorkerMeters>,
    /// How the detector's model is read, once it has started.
    pub(crate) reading: OnceLock<ModelReading>,
    power: Mutex<PowerPast>,
    /// The places that messages are forwarded to.
    forwarded: Mutex<Vec<Arc<Forwarded>>>,
    started_ms: i64,
    today: Mutex<Today>,
}

/// The meters of the models.
#[derive(Debug)]
pub(crate) struct WorkerMeters {
    pub(crate) detector: WorkerMeter,
    /// `None` without a screen.
    pub(crate) screen: Option<WorkerMeter>,
}

/// The counts of the models: zero before they start, and without a screen.
#[derive(Debug, Default)]
pub(crate) struct ModelCounts {
    pub(crate) detector: WorkerCounts,
    pub(crate) screen: WorkerCounts,
}

/// What was saved, over two spans.
#[derive(Debug)]
pub(crate) struct SavingsSoFar {
    /// Since the node's start.
    pub(crate) since_start: Savings,
    /// Since midnight UTC, or since the start if that is later.
    pub(crate) today: Savings,
}

/// How the detector's model is read, and what of its output is left out.
#[derive(Debug)]
pub(crate) struct ModelReading {
    /// Head and input, in words.
    pub(crate) description: String,
    /// The classes that are reported.
    pub(crate) classes: Vec<String>,
    /// The model's classes that are not reported.
    pub(crate) left_out: Vec<String>,
    /// The counts of boxes that were not reported.
    pub(crate) meter: HeadMeter,
    /// The sizes of its input in use.
    pub(crate) preparation: Preparation,
    /// Whether its provider finds what the CPU finds.
    pub(crate) precision: PrecisionProof,
    /// The build of its engine, while another provider answers.
    pub(crate) engine_build: EngineBuild,
}

/// What the board of a node shows that never changes, and what its parts begin with.
#[derive(Debug)]
pub(crate) struct BoardSetup {
    /// The node's name.
    pub node: String,
    /// File name of the detector's model.
    pub model: String,
    /// Requested execution providers, in order.
    pub providers: Vec<ExecutionProvider>,
    /// The cameras, in the order of the configuration.
    pub cameras: Vec<CameraSetup>,
    /// The certificates of its sessions.
    pub certificates: Certificates,
    /// The positions, of which there are none yet.
    pub positions: Positions,
    /// The target, which holds nothing yet.
    pub target: NodeTarget,
    /// The pause on an empty road.
    pub empty_road: EmptyRoad,
    /// When a class counts as there, and as away.
    pub sightings: SightingsConfig,
}

impl Board {
    /// Creates the board of a node under that policy, without frames, with the configured thresholds in force.
    pub(crate) fn new(setup: BoardSetup, policy: NodePolicy) -> Arc<Self> {
        let policy = Arc::new(policy);
        let shared = Shared {
            node: setup.node.as_str().into(),
            started: Instant::now(),
            events: broadcast::channel(EVENT_BACKLOG).0,
            sightings: broadcast::channel(SIGHTING_BACKLOG).0,
            empty_road: watch::Sender::new(setup.empty_road),
        };
        let camera = |camera| {
            let shared = shared.clone();
            Arc::new(CameraBoard::new(camera, &policy, setup.sightings, shared))
        };
        let cameras = setup.cameras.into_iter().map(camera).collect();
        let readiness = Readiness::default();
        let detector = Arc::new(Mutex::new(ModelStatus::Starting));
        let status = Arc::clone(&detector);
        readiness.probe(readiness::DETECTOR, "", move || {
            readiness::of_detector(&status.lock())
        });
        let certificates = setup.certificates.clone();
        readiness.probe(readiness::CERTIFICATES, "", move || {
            certificates.fault().map(Fault::degraded)
        });
        let positions = Arc::new(setup.positions);
        let located = Arc::clone(&positions);
        readiness.probe(readiness::POSITION, "", move || {
            located.fault().map(Fault::degraded)
        });
        let started_ms = unix_milliseconds();
        Arc::new(Self {
            node: setup.node,
            model: setup.model,
            providers: setup.providers,
            cameras,
            readiness,
            tasks: TaskFailures::default(),
            certificates: setup.certificates,
            positions,
            target: setup.target,
            policy: Mutex::new(Arc::clone(&policy)),
            configured_policy: policy,
            switched: Mutex::default(),
            configured_road: setup.empty_road,
            shared,
            clips: Mutex::default(),
            detector,
            meters: OnceLock::new(),
            reading: OnceLock::new(),
            power: Mutex::default(),
            forwarded: Mutex::default(),
            started_ms,
            today: Mutex::new(Today {
                since_ms: started_ms,
                before: Totals::default(),
            }),
        })
    }

    /// The counts of the detector and the screen.
    pub(crate) fn model_counts(&self) -> ModelCounts {
        let Some(WorkerMeters { detector, screen }) = self.meters.get() else {
            return ModelCounts::default();
        };
        ModelCounts {
            detector: detector.read(),
            screen: screen.as_ref().map(WorkerMeter::read).unwrap_or_default(),
        }
    }

    /// The time since the board was created.
    pub(crate) fn uptime(&self) -> Duration {
        self.shared.started.elapsed()
    }

    /// The camera named `name`.
    pub fn camera(&self, name: &str) -> Option<&Arc<CameraBoard>> {
        Some(&self.cameras[self.camera_place(name)?])
    }

    /// The place of the camera named `name` in the configuration.
    pub(crate) fn camera_place(&self, name: &str) -> Option<usize> {
        self.cameras.iter().position(|camera| camera.name() == name)
    }

    /// Subscribes to events from now on. A reader that falls more than 1024 events behind gets `RecvError::Lagged` with
    /// the number of lost events.
    pub fn subscribe(&self) -> broadcast::Receiver<Arc<Event>> {
        self.shared.events.subscribe()
    }

    /// Adds a place that messages are forwarded to, with a name of its own.
    pub(crate) fn forward_to(&self, place: String) -> Arc<Forwarded> {
        let mut forwarded = self.forwarded.lock();
        let is_same = |other: &&Arc<Forwarded>| match other.to.strip_prefix(&place) {
            Some(number) => number.is_empty() || number.starts_with(" ("),
            None => false,
        };
        let same = forwarded.iter().filter(is_same).count();
        let name = match same {
            0 => place,
            same => format!("{place} ({})", same + 1),
        };
        let counts = Arc::new(Forwarded::new(name));
        forwarded.push(Arc::clone(&counts));
        counts
    }

    /// What was forwarded since the start, by place.
    pub(crate) fn forwarded(&self) -> Vec<ForwardedCounts> {
        self.forwarded.lock().iter().map(|one| one.counts()).collect()
    }

    /// Keeps a clip's report, counts it for its camera and sends it to subscribers.
    pub fn record_clip(&self, report: ClipReport) {
        if let Some(camera) = self.camera(&report.camera) {
            camera.count_clip(report.energy.joules);
        }
        let report = Arc::new(report);
        let mut clips = self.clips.lock();
        if clips.len() == RECENT_CLIPS {
            clips.pop_front();
        }
        clips.push_back(Arc::clone(&report));
        drop(clips);
        // An error only means that there are no subscribers.
        let _ = self.shared.events.send(Event::new(News::Clip(report)));
    }

    /// The newest clip reports, newest first, of one camera or of all, at most `limit`: those older than `before` and
    /// newer than `after`. No report is older than an unknown `before`, and all are newer than an unknown `after`.
    pub fn recent_clips(
        &self,
        camera: Option<&str>,
        before: Option<Uuid>,
        after: Option<Uuid>,
        limit: usize,
    ) -> Vec<Arc<ClipReport>> {
        let clips = self.clips.lock();
        let mut newest_first = clips.iter().rev();
        if let Some(before) = before {
            // Passes over the reports up to this one.
            newest_first.by_ref().find(|report| report.id == before);
        }
        newest_first
            .take_while(|report| Some(report.id) != after)
            .filter(|report| camera.is_none_or(|name| report.camera == name))
            .take(limit)
            .cloned()
            .collect()
    }

    /// Returns the present counter messages of all cameras and sends them to subscribers. Call it once per
    /// second; `t_ns` is the wall clock, nanoseconds since the Unix epoch.
    pub fn publish_counters(&self, t_ns: u64) -> Vec<Arc<CountersMessage>> {
        self.turn_day();
        let mut messages = Vec::with_capacity(self.cameras.len());
        for camera in &self.cameras {
            camera.sample_flow();
            let message = Arc::new(self.counters(camera, t_ns));
            let news = News::Counters(Arc::clone(&message));
            let _ = self.shared.events.send(Event::new(news));
            messages.push(message);
        }
        messages
    }

    /// The present state as events: the detector, and thresholds and counters of every camera.
    pub(crate) fn current(&self, t_ns: u64) -> Vec<Arc<Event>> {
        let detector = DetectorEvent::new(&self.detector.lock());
        let mut events = vec![Event::new(News::Detector(detector))];
        for camera in &self.cameras {
            if let Some(threshold) = camera.threshold_in_force() {
                events.push(Event::new(camera.threshold_news(threshold)));
            }
            let counters = Arc::new(self.counters(camera, t_ns));
            events.push(Event::new(News::Counters(counters)));
        }
        events
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
            target: if self.target.is_on() {
                Some(self.target.report())
            } else {
                None
            },
            audit: snapshot.policy_audit.as_ref().map(AuditReport::figures),
        }
    }

    /// The present status of the detector.
    pub(crate) fn detector_status(&self) -> ModelStatus {
        self.detector.lock().clone()
    }

    /// Sets the detector's status and sends it to subscribers.
    pub fn set_detector_status(&self, status: ModelStatus) {
        let news = News::Detector(DetectorEvent::new(&status));
        *self.detector.lock() = status;
        let _ = self.shared.events.send(Event::new(news));
    }

    /// Sets the power figures; called by the sampling task.
    pub fn set_power(&self, power: PowerSnapshot) {
        self.power.lock().add(power, self.uptime());
    }

    /// The power over the last hour, oldest first.
    pub(crate) fn power_past(&self) -> Vec<PowerPiece> {
        self.power.lock().slots(&Clock::now(self.shared.started))
    }

    /// The counts since the start, with this power.
    pub(crate) fn totals(&self, power: PowerSnapshot) -> Totals {
        let mut totals = Totals {
            power,
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
        let so_far = || self.totals(self.power());
        self.today.lock().turn(unix_milliseconds(), so_far);
    }

    /// The savings since the start, and today.
    pub(crate) fn savings(&self) -> SavingsSoFar {
        self.turn_day();
        let now = self.totals(self.power());
        let today = self.today.lock();
        SavingsSoFar {
            since_start: now.savings(self.started_ms),
            today: now.since(&today.before).savings(today.since_ms),
        }
    }

    /// The last power figures.
    pub fn power(&self) -> PowerSnapshot {
        self.power.lock().newest().clone()
    }
}

#[cfg(test)]
pub(crate) mod tests;
