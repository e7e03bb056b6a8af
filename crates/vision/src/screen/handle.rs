//! The handle through which cameras use the screen.

use super::network::ScreenNetwork;
use super::{Logits, ScreenConfig};
use crate::detector::{
    CameraSlot, DetectorStatus, InferenceError, Preparation, PreparedPicture, StartError,
    prepare_off_thread,
};
use crate::picture::{InputFormat, Picture};
use crate::worker::{Worker, WorkerMeter, WorkerSettings};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// What the screen says of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScreenVerdict {
    /// Nothing is in view.
    pub empty: bool,
    /// The two outputs it was decided by.
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
    /// Loads the screen's model on its own thread, checks it and warms it up; `None` when the
    /// configuration names no model. `onnxruntime` is the library, if it is named.
    ///
    /// # Errors
    /// When the library or the model is not as configured.
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
        let (worker, input) = Worker::start(settings, build).await?;
        Ok(Some(Self {
            worker,
            preparation: Preparation::new(input),
            empty_is_second: config.empty_is_second,
        }))
    }

    /// What the model wants to see.
    pub fn input_format(&self) -> InputFormat {
        self.preparation.format()
    }

    /// Whether nothing is in view in `picture`. Equal outputs count as not empty.
    ///
    /// # Errors
    /// See [`InferenceError`]. Whatever the error, the frame counts as not empty.
    pub async fn ask(
        &self,
        camera: CameraSlot,
        picture: Arc<Picture>,
    ) -> Result<ScreenVerdict, InferenceError> {
        let prepared = prepare_off_thread(self.preparation.clone(), picture).await?;
        let logits = self.worker.run(camera, prepared).await?.output;
        let [first, second] = logits;
        let empty = match self.empty_is_second {
            true => second > first,
            false => first > second,
        };
        Ok(ScreenVerdict { empty, logits })
    }

    /// How the screen is doing, now and from now on.
    pub fn status(&self) -> watch::Receiver<DetectorStatus> {
        self.worker.status.clone()
    }

    /// Its counters for metrics: does not keep the screen running.
    pub fn meter(&self) -> WorkerMeter {
        self.worker.meter.clone()
    }

    /// Returns when it has been stopped.
    ///
    /// # Errors
    /// When its thread is stuck: only a new process helps.
    pub async fn ended(&self) -> Result<(), String> {
        self.worker.ended().await
    }

    /// Takes no more pictures and returns when the run in progress has ended or has taken too long.
    pub async fn stop(&self) {
        self.worker.stop().await;
    }
}
