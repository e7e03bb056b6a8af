//! Adds a camera to a starting node: its publishers, its loop, its reporter, its threshold and its source of frames.

use super::PolicyMaker;
use crate::camera::audit::{CameraAudit, Examiner};
use crate::camera::evidence::LiveEvidence;
use crate::camera::{AnswerTime, Camera, CameraParts};
use crate::config::{CameraConfig, NodeConfig};
use crate::delivery::report::Reporter;
use crate::error::NodeError;
use crate::input::Delivery;
use crate::input::receiver::FrameReceiver;
use crate::input::source::{LiveSource, SourceEvent, SourceSettings};
use crate::publishing::{self, Outlet};
use crate::state::board::{Board, CameraBoard};
use crate::state::readiness;
use albireo_core::policy::{LatePolicy, MinConfidence};
use albireo_power::PowerHandle;
use albireo_service::supervise::Supervisor;
use albireo_vision::detector::{CameraSlot, DetectorHandle};
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::{EmptyRun, ScreenHandle};
use albireo_wire::{HealthState, stream_of_token, stream_token};
use futures_util::FutureExt;
use std::any::Any;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::qos::CongestionControl;
use zenoh::sample::SampleKind;
use zenoh_ext::{AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

/// The number of clip reports that a publisher keeps for late subscribers.
const CACHED_REPORTS: usize = 64;

/// The Zenoh subscribers and queryables that receive frames; dropping them undeclares them.
pub(super) type Subscriptions = Vec<Box<dyn Any + Send + Sync>>;

/// Adds cameras to a starting node and creates their loops: the parts of the node that they share.
pub(super) struct Cameras {
    pub(super) config: NodeConfig,
    pub(super) session: Session,
    pub(super) board: Arc<Board>,
    pub(super) power: PowerHandle,
    pub(super) pixels: PixelWork,
    pub(super) detector: DetectorHandle,
    pub(super) screen: Option<ScreenHandle>,
    pub(super) policies: PolicyMaker,
    /// Once cancelled, no camera waits for the detector any more.
    pub(super) give_up: CancellationToken,
    pub(super) shutdown: CancellationToken,
}

impl Cameras {
    pub(super) async fn add(
        self: &Arc<Self>,
        slot: CameraSlot,
        config: &CameraConfig,
        board: &Arc<CameraBoard>,
        tasks: &mut Supervisor,
        subscriptions: &mut Subscriptions,
    ) -> Result<(), NodeError> {
        let keys = &board.keys;
        let name = &config.name;
        let receiver = Arc::new(FrameReceiver::new(
            config.receiver_settings(self.config.frame),
            Arc::clone(&board.input),
        ));
        let (closed, clips) = mpsc::unbounded_channel();

        // A replay must not lose any answer.
        let sent = match config.delivery {
            Delivery::Newest => (CongestionControl::Drop, publishing::LIVE),
            Delivery::Every => (CongestionControl::Block, publishing::EVERY),
        };
        let outlet = |key: String| Outlet::declare(&self.session, key, sent, &board.unpublished);
        let detections = outlet(keys.detections()).await?;
        let late = match self.config.answer_time(config) {
            AnswerTime::WhenKnown => None,
            AnswerTime::AtOnce => Some(outlet(keys.late()).await?),
        };
        let settled = match self.config.settle.enabled {
            true => Some(outlet(keys.settled()).await?),
            false => None,
        };
        let reports = self
            .session
            .declare_publisher(keys.clip())
            .congestion_control(CongestionControl::Drop)
            .priority(publishing::CLIPS)
            .cache(CacheConfig::default().max_samples(CACHED_REPORTS))
            .sample_miss_detection(MissDetectionConfig::default())
            .publisher_detection()
            .await
            .map_err(NodeError::refused("clip reports cannot be published"))?;

        let report = self.config.report.confidence;
        let parts = Arc::new(CameraParts {
            board: Arc::clone(board),
            receiver: Arc::clone(&receiver),
            detections,
            late,
            settled,
            min_confidence: MinConfidence::new(report, self.config.detector.confidence),
            class_names: self.detector.class_names().to_vec(),
            closed,
            energy: self.power.camera(),
            reset_at_clip: config.reset_at_clip,
        });
        let cameras = Arc::clone(self);
        tasks.restarting(format!("camera {name}"), HealthState::NotReady, move || {
            let camera = cameras.camera(slot, Arc::clone(&parts));
            let stop = cameras.shutdown.clone();
            async move {
                camera?.run(stop).await;
                Ok::<(), NodeError>(())
            }
        });
        let reporter = Reporter {
            board: Arc::clone(&self.board),
            camera: Arc::clone(board),
            listeners: reports,
        };
        tasks.essential(format!("reporter {name}"), reporter.run(clips));

        if let Some(settings) = config.source_settings(self.config.frame) {
            return self.add_source(name, receiver, settings, tasks).await;
        }
        let key = &board.key;
        let refused = || NodeError::refused(format!("frames on `{key}` cannot be received"));
        if config.delivery == Delivery::Every {
            let every_frame = Arc::clone(&receiver);
            let queryable = self
                .session
                .declare_queryable(key.clone())
                .complete(true)
                .callback(move |query| every_frame.take_query(query))
                .await
                .map_err(refused())?;
            subscriptions.push(Box::new(queryable));
        }
        let publishers = Arc::clone(&receiver);
        let tokens = self
            .session
            .liveliness()
            .declare_subscriber(stream_token(key, "*"))
            .callback(move |token| {
                if let Some(stream) = stream_of_token(token.key_expr().as_str()) {
                    publishers.publisher_changed(stream, token.kind() == SampleKind::Delete);
                }
            })
            .await
            .map_err(refused())?;
        let frames = self
            .session
            .declare_subscriber(key.clone())
            .callback(move |sample| receiver.take(&sample))
            .await
            .map_err(refused())?;
        subscriptions.push(Box::new((tokens, frames)));
        Ok(())
    }

    /// Feeds the camera from a source that the node keeps open.
    async fn add_source(
        &self,
        name: &str,
        receiver: Arc<FrameReceiver>,
        settings: SourceSettings,
        tasks: &mut Supervisor,
    ) -> Result<(), NodeError> {
        // On a blocking thread, because it runs the programs to read their versions.
        let found = tokio::task::spawn_blocking(move || LiveSource::find(settings)).await;
        let source = found.map_err(NodeError::new)?.map_err(NodeError::new)?;
        let readiness = &self.board.readiness;
        let part = readiness.part_of(readiness::CAMERAS, name);
        let each = move |event| match event {
            SourceEvent::Picture { picture, reopened } => {
                if reopened && picture.is_ok() {
                    part.works();
                }
                receiver.take_picture(picture, reopened);
            }
            SourceEvent::Failed { reason, pause } => {
                let seconds = pause.as_secs_f64();
                part.degraded(format!("failed: {reason}; next attempt in {seconds} s"));
            }
        };
        let stop = self.shutdown.clone();
        tasks.restarting(format!("source {name}"), HealthState::Degraded, move || {
            source.clone().run(each.clone(), stop.clone())
        });
        Ok(())
    }

    /// Creates a camera's loop, at its start and whenever it has failed.
    fn camera(&self, slot: CameraSlot, parts: Arc<CameraParts>) -> Result<Camera, NodeError> {
        let policy = (self.policies)(parts.board.name()).map_err(NodeError::new)?;
        let policy = match parts.late {
            Some(_) => LatePolicy::new(policy).map_err(NodeError::new)?,
            None => LatePolicy::waiting(policy),
        };
        let evidence = LiveEvidence::new(
            self.detector.clone(),
            self.screen.clone(),
            EmptyRun::new(self.config.screen.longest_empty_run),
            slot,
            self.pixels.clone(),
            self.give_up.clone(),
        );
        let examiner = Examiner {
            detector: self.detector.clone(),
            pixels: self.pixels.clone(),
            energy: parts.energy.clone(),
        };
        let board = Arc::clone(&parts.board);
        let examine = move |picture, shown| examiner.clone().look(picture, shown).boxed();
        let audit = CameraAudit::new(self.config.audit, board, examine);
        Ok(Camera::new(parts, &self.config, policy, evidence, audit))
    }
}
