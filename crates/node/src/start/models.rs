//! Loads the models of a node: the detector, and the screen if there is one.

use crate::error::NodeError;
use crate::state::board::{Board, ModelReading, WorkerMeters};
use crate::state::readiness;
use albireo_service::supervise::Supervisor;
use albireo_vision::detector::{DetectorConfig, DetectorHandle, ModelStatus, named_classes};
use albireo_vision::picture::FrameLimits;
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::{ScreenConfig, ScreenHandle};
use futures_util::future::OptionFuture;
use std::sync::Arc;
use tokio::sync::watch;

/// The models, each with its worker.
pub(super) struct Models {
    pub(super) detector: DetectorHandle,
    pub(super) screen: Option<ScreenHandle>,
}

impl Models {
    /// Loads the models, and shows on the board how they are read. That may take minutes, or hang.
    pub(super) async fn start(
        detector: &DetectorConfig,
        screen: &ScreenConfig,
        board: &Board,
    ) -> Result<Self, NodeError> {
        tracing::info!(model = %detector.model.display(), "loading the detector");
        let library = detector.onnxruntime.as_deref();
        let detector =
            DetectorHandle::start(detector).await.map_err(NodeError::of("[detector]"))?;
        show_reading(&detector, board);
        let screen =
            ScreenHandle::start(screen, library).await.map_err(NodeError::of("[screen]"))?;
        if let Some(screen) = &screen {
            let status = screen.status();
            board.readiness.probe(readiness::SCREEN, "", move || {
                readiness::of_screen(&status.borrow())
            });
        }
        // Set once: a node starts its models once.
        let _ = board.meters.set(WorkerMeters {
            detector: detector.meter(),
            screen: screen.as_ref().map(ScreenHandle::meter),
        });
        Ok(Self { detector, screen })
    }

    /// Ends the node with a worker that ends, and shows the detector's status on the board.
    pub(super) fn watch(&self, tasks: &mut Supervisor, board: &Arc<Board>) {
        tasks.until_shutdown(
            "detector status",
            follow(self.detector.status(), Arc::clone(board)),
        );
        let worker = self.detector.clone();
        tasks.until_shutdown("detector", async move { worker.ended().await });
        if let Some(worker) = self.screen.clone() {
            tasks.until_shutdown("screen", async move { worker.ended().await });
        }
    }

    /// What prepares pictures for the models.
    pub(super) fn pixels(&self, limits: FrameLimits, batch_size: usize) -> PixelWork {
        let screen = self.screen.as_ref().map(ScreenHandle::input_format);
        PixelWork::new(
            self.detector.preparation().clone(),
            screen,
            limits,
            batch_size,
        )
    }

    /// Stops the workers.
    pub(super) async fn stop(&self) {
        let screen = OptionFuture::from(self.screen.as_ref().map(ScreenHandle::stop));
        tokio::join!(self.detector.stop(), screen);
    }
}

/// Logs how the detector's model is read, and shows it on the board.
fn show_reading(detector: &DetectorHandle, board: &Board) {
    let left_out = detector.left_out();
    let remedy = match left_out {
        [] => "",
        _ => "; detector.report_classes = [] reports all classes of the model",
    };
    tracing::info!(
        reads = detector.description(),
        provider = detector.provider().as_str(),
        reports = named_classes(detector.class_names()).join(", "),
        not_reported = left_out.len(),
        "the detector is ready{remedy}"
    );
    let _ = board.reading.set(ModelReading {
        description: detector.description().to_owned(),
        classes: detector.class_names().to_vec(),
        left_out: left_out.to_vec(),
        meter: detector.head_meter(),
        preparation: detector.preparation().clone(),
        precision: detector.precision(),
        engine_build: detector.engine_build(),
    });
}

/// Copies the detector's status to the board.
async fn follow(mut from: watch::Receiver<ModelStatus>, to: Arc<Board>) {
    loop {
        let status = from.borrow_and_update().clone();
        to.set_detector_status(status);
        if from.changed().await.is_err() {
            return;
        }
    }
}
