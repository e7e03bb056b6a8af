//! One detector shared by all cameras.

use super::network::DetectorNetwork;
use super::opening::Among;
use super::preparation::prepare_off_thread;
use super::{
    CameraSlot, DetectorConfig, ExecutionProvider, Found, HeadMeter, InputUse, PrecisionProof,
    Preparation,
};
use super::{PreparedPicture, StartError};
use crate::onnx::last_build;
use crate::picture::Picture;
use crate::worker::{
    Announcement, Answer, Asker, Build, ModelStatus, RunError, Worker, WorkerCounts,
};
use crate::worker::{WorkerMeter, WorkerSettings};
use albireo_core::geometry::PictureSize;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::time::Instant;

/// The detector's answer for one picture.
pub type Detected = Answer<Found>;

/// A detector on its own thread: cheap to clone, shared by all cameras, stopped when the last handle is dropped.
#[derive(Clone)]
pub struct DetectorHandle {
    worker: Worker<PreparedPicture, Found>,
    model_name: Arc<str>,
    class_names: Arc<[String]>,
    left_out: Arc<[String]>,
    description: Arc<str>,
    head_meter: HeadMeter,
    proof: PrecisionProof,
    expected_build: Option<Duration>,
    preparation: Preparation,
    spare: Arc<Semaphore>,
    batch_size: usize,
    join: f64,
}

/// The build of TensorRT's engine while another provider answers; does not keep the detector running.
#[derive(Clone, Debug)]
pub struct EngineBuild {
    begun: watch::Receiver<Option<Instant>>,
    expected: Option<Duration>,
}

impl EngineBuild {
    /// The time since it began; `None` if nothing is being built.
    pub fn elapsed(&self) -> Option<Duration> {
        self.begun.borrow().map(|begun| begun.elapsed())
    }

    /// How long the last build took on this machine, of this model or of another.
    pub fn expected(&self) -> Option<Duration> {
        self.expected
    }
}

/// The right to have one picture answered while no camera waits.
pub type SpareTurn = OwnedSemaphorePermit;

impl DetectorHandle {
    /// Loads the model on its own thread, checks that it fits its head, and warms it up. If TensorRT is the first of several
    /// providers and the configuration says so, the others answer while it builds its engine, and it takes over when that
    /// is there; if it cannot, the log says why and they go on.
    ///
    /// # Errors
    /// If the library, the model, its head or the execution provider is not as configured.
    pub async fn start(config: &DetectorConfig) -> Result<Self, StartError> {
        config.check()?;
        let settings = WorkerSettings {
            name: "detector",
            timeout: Duration::from_millis(config.timeout_ms),
            batch_size: config.batch_size,
            batch_wait: Duration::from_millis(config.batch_wait_ms),
        };
        let model_name = config.model.file_name().unwrap_or_default().to_string_lossy().into();
        let head_meter = HeadMeter::default();
        let proof = PrecisionProof::new(config);
        let build = |among| {
            let config = config.clone();
            let counting = head_meter.clone();
            let proof = proof.clone();
            // Called again whenever the model is rebuilt.
            move || {
                let network = DetectorNetwork::open_counting(&config, among, counting.clone())?;
                Ok(network.proved_by(proof.clone()))
            }
        };
        // An engine takes minutes to build: whatever else is listed answers until then.
        let others_answer = config.answers_while_building
            && config.providers.len() > 1
            && config.providers.first() == Some(&ExecutionProvider::TensorRt);
        let of_first = if others_answer {
            Among::Meanwhile
        } else {
            Among::All
        };
        let first = build(of_first);
        let successor: Option<Build<DetectorNetwork>> = if others_answer {
            Some(Box::new(build(Among::TensorRt)))
        } else {
            None
        };
        let meter = WorkerMeter::default();
        let (worker, facts) = Worker::start(settings, meter, first, successor).await?;
        Ok(Self {
            worker,
            model_name,
            class_names: facts.class_names.into(),
            left_out: facts.left_out.into(),
            description: facts.description.into(),
            head_meter,
            proof,
            expected_build: config.gpu.engine_cache.as_deref().and_then(last_build),
            preparation: Preparation::new(facts.input),
            spare: Arc::new(Semaphore::new(1)),
            batch_size: config.batch_size,
            join: config.join,
        })
    }

    /// Makes the model's input from pictures, on any thread, before [`detect_prepared`](Self::detect_prepared).
    pub fn preparation(&self) -> &Preparation {
        &self.preparation
    }

    /// Finds the objects in `picture`: prepares it on a blocking thread, then waits for the camera's turn and for the
    /// run. After `Ok` the detector no longer holds the picture.
    ///
    /// # Errors
    /// See [`RunError`].
    pub async fn detect(
        &self,
        camera: CameraSlot,
        picture: Arc<Picture>,
    ) -> Result<Detected, RunError> {
        let prepared = prepare_off_thread(self.preparation.clone(), picture).await?;
        self.detect_prepared(camera, prepared).await
    }

    /// Says, before a picture of this size is prepared, that the camera is about to ask: until its run begins, others wait
    /// for it and may [join](Self::join) its run. Keep the announcement until the answer has come.
    pub fn announce(&self, camera: CameraSlot, picture: PictureSize) -> Announcement {
        let size = self.preparation.input_size(picture);
        self.worker.coming.announce(Asker(camera.0), size)
    }

    /// The share of its threshold that a policy may fall short of on a frame of this size, for
    /// [`Policy::set_join`](albireo_core::policy::Policy::set_join): as configured while a run is about to begin that the
    /// frame could share, else 0.
    pub fn join(&self, picture: PictureSize) -> f64 {
        if self.join == 0.0 {
            return 0.0;
        }
        let size = self.preparation.input_size(picture);
        if self.worker.coming.has_room(size, self.batch_size) {
            self.join
        } else {
            0.0
        }
    }

    /// Finds the objects in a picture that [`preparation`](Self::preparation) has prepared. Waits for the
    /// camera's turn and for the run.
    ///
    /// # Errors
    /// See [`RunError`]. After any error, the frame can be answered from prediction. A run that takes too long is
    /// answered at the limit, not later; while no session can accept pictures, the error comes at once.
    pub async fn detect_prepared(
        &self,
        camera: CameraSlot,
        picture: PreparedPicture,
    ) -> Result<Detected, RunError> {
        self.worker.run(Some(Asker(camera.0)), picture).await
    }

    /// Waits until the model has nothing to do; returns the right to call [`detect_spare`](Self::detect_spare), one at
    /// a time. `None` once the detector has been stopped.
    pub async fn spare_turn(&self) -> Option<SpareTurn> {
        let permit = Arc::clone(&self.spare).acquire_owned().await.ok()?;
        self.worker.idle().await?;
        Some(permit)
    }

    /// Finds the objects in a prepared picture while no camera waits: pictures of cameras that arrive meanwhile go
    /// first, and it counts only in [`WorkerCounts::spare`]. May be cancelled at any time.
    ///
    /// # Errors
    /// See [`RunError`].
    pub async fn detect_spare(
        &self,
        _turn: SpareTurn,
        picture: PreparedPicture,
    ) -> Result<Detected, RunError> {
        self.worker.run(None, picture).await
    }

    /// Checks that a picture would be accepted now. Counts a refusal: call this before decoding a picture.
    ///
    /// # Errors
    /// The error that [`detect_prepared`](Self::detect_prepared) would return at once.
    pub fn accepts(&self) -> Result<(), RunError> {
        self.worker.accepts()
    }

    /// The detector's status, updated as it changes.
    pub fn status(&self) -> watch::Receiver<ModelStatus> {
        self.worker.status.clone()
    }

    /// Returns the counts since the detector started.
    pub fn counters(&self) -> WorkerCounts {
        self.worker.meter.read()
    }

    /// Counters for metrics; does not keep the detector running.
    pub fn meter(&self) -> WorkerMeter {
        self.worker.meter.clone()
    }

    /// The names of the reported classes, by class number.
    pub fn class_names(&self) -> &[String] {
        &self.class_names
    }

    /// The names of the model's classes that are not reported.
    pub fn left_out(&self) -> &[String] {
        &self.left_out
    }

    /// The inputs of the pictures so far, by their shape.
    pub fn inputs(&self) -> Vec<InputUse> {
        self.preparation.inputs()
    }

    /// The head and the input, in one line.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// The counts of boxes that were not reported; does not keep the detector running.
    pub fn head_meter(&self) -> HeadMeter {
        self.head_meter.clone()
    }

    /// What compares the provider with the CPU, on the first picture in which something is found.
    pub fn precision(&self) -> PrecisionProof {
        self.proof.clone()
    }

    /// The build of an engine, while another provider answers.
    pub fn engine_build(&self) -> EngineBuild {
        EngineBuild {
            begun: self.worker.building.clone(),
            expected: self.expected_build,
        }
    }

    /// The model's file name.
    pub fn model_name(&self) -> &str {
        &self.model_name
    }

    /// The provider that actually runs the model, or ran it last.
    pub fn provider(&self) -> ExecutionProvider {
        let provider = self.worker.status.borrow().provider();
        // Always `Some`: a handle exists only once the first model has been built.
        provider.unwrap_or(ExecutionProvider::Cpu)
    }

    /// Returns when the detector has stopped.
    ///
    /// # Errors
    /// If its thread is stuck: only a new process helps.
    pub async fn ended(&self) -> Result<(), String> {
        self.worker.ended().await
    }

    /// Accepts no more pictures and returns when the run in progress has ended or exceeded its deadline.
    pub async fn stop(&self) {
        self.worker.stop().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::sync::mpsc::channel;

    /// The second session stands for TensorRT's: it is told from the first by a confidence that the box does not reach.
    #[tokio::test]
    #[ignore = "needs ONNX Runtime"]
    async fn a_session_answers_every_picture_until_the_one_that_takes_long_is_built() {
        let model = "../../tests/fixtures/models/colours.onnx";
        let first = DetectorConfig {
            model: Path::new(env!("CARGO_MANIFEST_DIR")).join(model),
            timeout_ms: 60_000,
            ..DetectorConfig::default()
        };
        let second = DetectorConfig {
            confidence: 0.9,
            ..first.clone()
        };
        let (go_on, may_build) = channel::<()>();
        let successor: Build<DetectorNetwork> = Box::new(move || {
            let _ = may_build.recv();
            DetectorNetwork::open(&second)
        });
        let settings = WorkerSettings {
            name: "detector",
            timeout: Duration::from_secs(60),
            batch_size: 1,
            batch_wait: Duration::ZERO,
        };
        let meter = WorkerMeter::default();
        let build = move || DetectorNetwork::open(&first);
        let (worker, facts) = Worker::start(settings, meter, build, Some(successor)).await.unwrap();
        let preparation = Preparation::new(facts.input);
        let mut green = Picture::black(preparation.format().size);
        // The confidence of its box is 204 of 255.
        for value in green.pixels.iter_mut().skip(1).step_by(3) {
            *value = 204;
        }
        let boxes = async || {
            let picture = preparation.prepare(&green).unwrap();
            let answer = worker.run(Some(Asker(0)), picture).await.unwrap();
            answer.output.detections.len()
        };
        assert_eq!(boxes().await, 1);
        go_on.send(()).unwrap();
        let of_second = async {
            loop {
                let count = boxes().await;
                if count != 1 {
                    return count;
                }
            }
        };
        let limit = Duration::from_secs(60);
        assert_eq!(tokio::time::timeout(limit, of_second).await, Ok(0));
        let counts = worker.meter.read();
        assert_eq!(counts.failed, 0);
        assert_eq!(counts.refused, 0);
        assert_eq!(counts.rebuilds, 0);
    }
}
