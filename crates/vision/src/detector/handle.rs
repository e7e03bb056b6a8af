//! What a camera's loop holds of the detector.

use super::network::DetectorNetwork;
use super::preparation::prepare_off_thread;
use super::reader::HeadCounters;
use super::task::{Inference, InferenceTask, SpareTurn, TaskCounters, TaskMeter, TaskSettings};
use super::{
    CameraSlot, DetectorConfig, DetectorStatus, ExecutionProvider, HeadCounts, InferenceError,
    Preparation, PreparedPicture, StartError,
};
use crate::picture::Picture;
use albireo_core::detection::Detection;
use albireo_service::clock::milliseconds;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// What the model found in one picture, and how long its own steps took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Best first, normalised to the source picture, above the configured confidence, overlaps suppressed.
    pub detections: Vec<Detection>,
    /// Resizing and conversion to the model's input tensor.
    pub letterbox: Duration,
    /// The model alone; of a batch, that of all its pictures.
    pub model: Duration,
    /// From output tensors to detections.
    pub head: Duration,
}

/// The detector's answer for one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Detected {
    /// Best first, normalised to the source picture, above the configured confidence, overlaps suppressed.
    pub detections: Vec<Detection>,
    /// From the start of the run to its end.
    pub took: Duration,
    /// How many pictures the run looked at; the time this one used is `took` divided by their number.
    pub pictures: u32,
    /// From being asked to the start of the run, milliseconds.
    pub queue_ms: f64,
    /// Resizing and conversion to the model's input tensor, milliseconds.
    pub letterbox_ms: f64,
    /// The model alone, milliseconds.
    pub model_ms: f64,
    /// From output tensors to detections, milliseconds.
    pub head_ms: f64,
}

/// The detector as a camera's loop sees it: cheap to clone, shared by all cameras. The detector stops when
/// the last handle is dropped.
#[derive(Clone)]
pub struct DetectorHandle {
    task: InferenceTask<PreparedPicture, Found>,
    facts: Arc<Facts>,
}

struct Facts {
    model_name: String,
    class_names: Vec<String>,
    preparation: Preparation,
    head: Arc<HeadCounters>,
}

/// What the detector has counted since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DetectorCounters {
    /// Runs and rebuilds.
    pub task: TaskCounters,
    /// What was found in the model's output and not reported.
    pub head: HeadCounts,
}

/// The detector's counters, without the detector.
#[derive(Clone, Debug)]
pub struct DetectorMeter {
    task: TaskMeter,
    head: Arc<HeadCounters>,
}

impl DetectorMeter {
    /// What the detector has counted since it started.
    pub fn read(&self) -> DetectorCounters {
        DetectorCounters {
            task: self.task.read(),
            head: self.head.counts(),
        }
    }
}

impl DetectorHandle {
    /// Loads the model on a thread of its own, checks that it fits its head, and warms it up.
    ///
    /// # Errors
    /// When the library, the model, its head or the execution provider is not as configured.
    pub async fn start(config: &DetectorConfig) -> Result<Self, StartError> {
        config.check()?;
        let head = Arc::new(HeadCounters::default());
        let settings = TaskSettings {
            batch_size: config.batch_size,
            batch_wait: Duration::from_millis(config.batch_wait_ms),
            ..TaskSettings::new(
                "detector",
                Duration::from_millis(config.timeout_ms),
                config.queue,
            )
        };
        let model_name = model_name(config);
        let (config, counters) = (config.clone(), head.clone());
        let factory = move || DetectorNetwork::open_counting(&config, counters.clone());
        let (task, (class_names, input)) = InferenceTask::start(settings, factory).await?;
        Ok(Self {
            task,
            facts: Arc::new(Facts {
                model_name,
                class_names,
                preparation: Preparation::new(input),
                head,
            }),
        })
    }

    /// Where pictures become the model's input, on any thread, before [`detect_prepared`](Self::detect_prepared).
    pub fn preparation(&self) -> &Preparation {
        &self.facts.preparation
    }

    /// Finds the objects in `picture`: prepares it on a blocking thread, waits for the camera's turn and for
    /// the run. After `Ok` the picture is no longer held.
    ///
    /// # Errors
    /// See [`InferenceError`].
    pub async fn detect(
        &self,
        camera: CameraSlot,
        picture: Arc<Picture>,
    ) -> Result<Detected, InferenceError> {
        let preparation = self.facts.preparation.clone();
        let prepared = prepare_off_thread(preparation, picture).await?;
        self.detect_prepared(camera, prepared).await
    }

    /// Finds the objects in a picture that [`preparation`](Self::preparation) has prepared. Waits for the
    /// camera's turn and for the run.
    ///
    /// # Errors
    /// See [`InferenceError`]. Whatever the error, the frame can be answered from prediction. A run that
    /// takes too long is answered at the limit, not later; while the session is being rebuilt the answer
    /// comes at once.
    pub async fn detect_prepared(
        &self,
        camera: CameraSlot,
        picture: PreparedPicture,
    ) -> Result<Detected, InferenceError> {
        let inference = self.task.run(camera, picture).await?;
        Ok(detected(inference))
    }

    /// Returns when the model has nothing to do, with the right to ask [`detect_spare`](Self::detect_spare); one at a
    /// time. `None` once the detector has been stopped.
    pub async fn spare_turn(&self) -> Option<SpareTurn> {
        self.task.spare_turn().await
    }

    /// Finds the objects in a prepared picture while nobody else asks: frames that come meanwhile go before it, and it
    /// is in none of the counters but [`TaskCounters::spare`]. `None` when the run could not begin before `until`.
    ///
    /// # Errors
    /// See [`InferenceError`].
    pub async fn detect_spare(
        &self,
        turn: SpareTurn,
        picture: PreparedPicture,
        until: Instant,
    ) -> Result<Option<Detected>, InferenceError> {
        let inference = self.task.run_spare(turn, picture, until).await?;
        Ok(inference.map(detected))
    }

    /// Whether a picture would be taken now. A refusal is counted: ask before a picture is decoded for it.
    ///
    /// # Errors
    /// As [`detect_prepared`](Self::detect_prepared) would answer at once.
    pub fn accepts(&self) -> Result<(), InferenceError> {
        self.task.accepts()
    }

    /// How the detector is doing, now and from now on.
    pub fn status(&self) -> watch::Receiver<DetectorStatus> {
        self.task.status()
    }

    /// What it has counted since it started.
    pub fn counters(&self) -> DetectorCounters {
        self.meter().read()
    }

    /// Its counters for whoever shows them: does not keep the detector running.
    pub fn meter(&self) -> DetectorMeter {
        DetectorMeter {
            task: self.task.meter(),
            head: self.facts.head.clone(),
        }
    }

    /// The names of the reported classes, by class number.
    pub fn class_names(&self) -> &[String] {
        &self.facts.class_names
    }

    /// The model's file name.
    pub fn model_name(&self) -> &str {
        &self.facts.model_name
    }

    /// What really runs the model, or ran it last.
    pub fn provider(&self) -> ExecutionProvider {
        match *self.task.status().borrow() {
            DetectorStatus::Ready { provider }
            | DetectorStatus::Degraded { provider, .. }
            | DetectorStatus::Lost { provider, .. } => provider,
            // Not seen from outside: a handle exists only once the first model stands.
            DetectorStatus::Starting => ExecutionProvider::Cpu,
        }
    }

    /// Returns when it has been stopped, or what watches over it is gone.
    pub async fn ended(&self) {
        self.task.ended().await;
    }

    /// Takes no more pictures and returns when the run in hand has ended or has taken too long.
    pub async fn stop(&self) {
        self.task.stop().await;
    }
}

fn detected(inference: Inference<Found>) -> Detected {
    let found = inference.output;
    Detected {
        detections: found.detections,
        took: inference.took,
        pictures: inference.pictures,
        queue_ms: milliseconds(inference.queued),
        letterbox_ms: milliseconds(found.letterbox),
        model_ms: milliseconds(found.model),
        head_ms: milliseconds(found.head),
    }
}

fn model_name(config: &DetectorConfig) -> String {
    config
        .model
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}
