//! The handle through which cameras use the screen.

use super::network::ScreenNetwork;
use super::{Logits, ScreenConfig};
use crate::detector::{CameraSlot, Preparation, PreparedPicture, prepare_off_thread};
use crate::onnx::StartError;
use crate::picture::{InputFormat, Picture};
use crate::worker::{Asker, ModelStatus, RunError, Worker, WorkerMeter, WorkerSettings};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// The screen's verdict on one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScreenVerdict {
    /// True if nothing is in view.
    pub empty: bool,
    /// The two outputs that the verdict is based on.
    pub logits: Logits,
}

/// The screen as a camera's loop sees it: cheap to clone, shared by all cameras.
#[derive(Clone)]
pub struct ScreenHandle {
    worker: Worker<PreparedPicture, Logits>,
    preparation: Preparation,
    empty_is_second: bool,
}

impl ScreenHandle {
    /// Loads the screen's model on its own thread, checks it and warms it up; returns `None` if the configuration names
    /// no model. `onnxruntime` is the path of the library, if configured.
    ///
    /// # Errors
    /// If the library or the model is not as configured.
    pub async fn start(
        config: &ScreenConfig,
        onnxruntime: Option<&Path>,
    ) -> Result<Option<Self>, StartError> {
        let Some(model) = config.model.clone() else {
            return Ok(None);
        };
        let library = onnxruntime.map(Path::to_owned);
        let its_config = config.clone();
        let build = move || ScreenNetwork::open(&model, &its_config, library.clone());
        let settings = WorkerSettings {
            name: "screen",
            timeout: Duration::from_millis(config.timeout_ms),
            batch_size: 1,
            batch_wait: Duration::ZERO,
        };
        let meter = WorkerMeter::default();
        let no_successor = None;
        let (worker, input) = Worker::start(settings, meter, build, no_successor).await?;
        Ok(Some(Self {
            worker,
            preparation: Preparation::new(input),
            empty_is_second: config.empty_is_second,
        }))
    }

    /// The input that the model expects.
    pub fn input_format(&self) -> InputFormat {
        self.preparation.format()
    }

    /// Decides whether nothing is in view in `picture`. Equal outputs count as not empty.
    ///
    /// # Errors
    /// See [`RunError`]. After any error, the frame counts as not empty.
    pub async fn ask(
        &self,
        camera: CameraSlot,
        picture: Arc<Picture>,
    ) -> Result<ScreenVerdict, RunError> {
        let prepared = prepare_off_thread(self.preparation.clone(), picture).await?;
        let logits = self.worker.run(Some(Asker(camera.0)), prepared).await?.output;
        let [first, second] = logits;
        let empty = if self.empty_is_second {
            second > first
        } else {
            first > second
        };
        Ok(ScreenVerdict { empty, logits })
    }

    /// The screen's status, updated as it changes.
    pub fn status(&self) -> watch::Receiver<ModelStatus> {
        self.worker.status.clone()
    }

    /// Counters for metrics; does not keep the screen running.
    pub fn meter(&self) -> WorkerMeter {
        self.worker.meter.clone()
    }

    /// Returns when the screen has stopped.
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
