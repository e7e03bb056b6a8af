//! Adds the cameras to a starting node: each its publishers, its loop, its reporter and its source of frames.

use super::models::Models;
use crate::camera::audit::{CameraAudit, Examiner};
use crate::camera::clip::Clip;
use crate::camera::evidence::LiveEvidence;
use crate::camera::{AnswerTime, Camera, CameraParts, PolicyMaker};
use crate::config::{self, CameraConfig, NodeConfig};
use crate::delivery::report::Reporter;
use crate::error::NodeError;
use crate::input::Delivery;
use crate::input::receiver::FrameReceiver;
use crate::input::source::{LiveSource, SourceEvent, SourceSettings};
use crate::outbox::Outbox;
use crate::publishing::ros2::{Ros2Outlet, Ros2Place};
use crate::publishing::{self, Congestion, Outlet};
use crate::recorder::{PictureMemory, Recorder};
use crate::state::board::{Board, CameraBoard};
use crate::state::readiness;
use albireo_core::policy::MinConfidence;
use albireo_power::PowerHandle;
use albireo_service::supervise::Supervisor;
use albireo_vision::detector::CameraSlot;
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::EmptyRun;
use albireo_wire::{HealthState, stream_of_token, stream_token};
use futures_util::FutureExt;
use std::any::Any;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::qos::CongestionControl;
use zenoh::sample::SampleKind;
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

/// The number of clip reports that a publisher keeps for late subscribers.
const CACHED_REPORTS: usize = 64;

/// The Zenoh subscribers and queryables that receive frames; dropping them undeclares them.
pub(super) type Subscriptions = Vec<Box<dyn Any + Send + Sync>>;

/// The parts of the node that its cameras share.
pub(super) struct SharedParts {
    pub(super) config: NodeConfig,
    pub(super) session: Session,
    pub(super) board: Arc<Board>,
    pub(super) outbox: Arc<Outbox>,
    pub(super) recorder: Arc<Recorder>,
    pub(super) power: PowerHandle,
    pub(super) pixels: PixelWork,
    pub(super) models: Models,
    pub(super) policies: PolicyMaker,
    /// Once cancelled, no camera waits for the detector any more.
    pub(super) give_up: CancellationToken,
    pub(super) shutdown: CancellationToken,
}

impl SharedParts {
    /// Starts the recorder and adds all cameras. Returns what receives their frames.
    pub(super) async fn add_cameras(
        self: &Arc<Self>,
        tasks: &mut Supervisor,
    ) -> Result<Subscriptions, NodeError> {
        let memory = if self.config.zenoh.shared_memory {
            PictureMemory::Lent
        } else {
            PictureMemory::Own
        };
        // Before the cameras, whose frames it records.
        self.recorder
            .start(self.config.frame, memory)
            .map_err(NodeError::of("[record]"))?;
        let mut subscriptions = Subscriptions::new();
        for (slot, (camera, board)) in
            self.config.cameras.iter().zip(&self.board.cameras).enumerate()
        {
            let adding = self.add(CameraSlot(slot), camera, board, tasks, &mut subscriptions);
            let named = NodeError::of(format!("camera `{}`", camera.name));
            adding.await.map_err(named)?;
        }
        Ok(subscriptions)
    }

    async fn add(
        self: &Arc<Self>,
        slot: CameraSlot,
        config: &CameraConfig,
        board: &Arc<CameraBoard>,
        tasks: &mut Supervisor,
        subscriptions: &mut Subscriptions,
    ) -> Result<(), NodeError> {
        let name = &config.name;
        let receiver = Arc::new(FrameReceiver::new(
            config.receiver_settings(self.config.frame),
            Arc::clone(&board.input),
        ));
        let (closed, clips) = mpsc::unbounded_channel();

        let parts = Arc::new(self.camera_parts(slot, config, board, &receiver, closed).await?);
        let shared = Arc::clone(self);
        tasks.restarting(format!("camera {name}"), HealthState::NotReady, move || {
            let camera = shared.camera(slot, Arc::clone(&parts));
            let stop = shared.shutdown.clone();
            async move {
                camera?.run(stop).await;
                Ok::<(), NodeError>(())
            }
        });

        let reporter = Reporter {
            board: Arc::clone(&self.board),
            outbox: Arc::clone(&self.outbox),
            camera: Arc::clone(board),
            listeners: self.reports_publisher(board).await?,
        };
        tasks.essential(format!("reporter {name}"), reporter.run(clips));

        match config.source_settings(self.config.frame) {
            Some(settings) => self.add_source(board, receiver, settings, tasks).await,
            None => {
                for key in self.config.frame_keys(config).map_err(NodeError::new)? {
                    let receiver = Arc::clone(&receiver);
                    self.subscribe(config.delivery, &key, receiver, subscriptions).await?;
                }
                Ok(())
            }
        }
    }

    /// Declares the keys of a camera's answers, and collects what survives a restart of its loop.
    async fn camera_parts(
        &self,
        slot: CameraSlot,
        config: &CameraConfig,
        board: &Arc<CameraBoard>,
        receiver: &Arc<FrameReceiver>,
        closed: mpsc::UnboundedSender<Clip>,
    ) -> Result<CameraParts, NodeError> {
        let keys = &board.keys;
        // A replay must not lose any answer.
        let congestion = match config.delivery {
            Delivery::Newest => Congestion::LIVE_ANSWERS,
            Delivery::Every => Congestion::EVERY_ANSWER,
        };
        let outlet =
            |key: String| Outlet::declare(&self.session, key, congestion, &board.unpublished);
        let detections = outlet(keys.detections()).await?;
        let late = match self.config.answer_time(config) {
            AnswerTime::WhenKnown => None,
            AnswerTime::AtOnce => Some(outlet(keys.late()).await?),
        };
        let settled = if self.config.settle.enabled {
            Some(outlet(keys.settled()).await?)
        } else {
            None
        };
        let ros2 = if self.config.publish.ros2 {
            Some(self.ros2_outlet(&config.name, board).await?)
        } else {
            None
        };
        let least = self.config.report.confidence;
        Ok(CameraParts {
            board: Arc::clone(board),
            receiver: Arc::clone(receiver),
            policies: Arc::clone(&self.policies),
            detections,
            late,
            settled,
            ros2,
            min_confidence: MinConfidence::new(least, self.config.detector.confidence),
            class_names: self.models.detector.class_names().to_vec(),
            closed,
            energy: self.power.camera(),
            positions: Arc::clone(&self.board.positions),
            recorder: Arc::clone(&self.recorder).of_camera(slot.0),
            reset_at_clip: config.reset_at_clip,
        })
    }

    /// Declares the topic of a camera's boxes in ROS 2.
    async fn ros2_outlet(
        &self,
        camera: &str,
        board: &CameraBoard,
    ) -> Result<Ros2Outlet, NodeError> {
        let domain = config::ros_domain().map_err(NodeError::new)?;
        let node = &self.config.node;
        let place = Ros2Place::new(domain, &node.prefix, &node.name, camera);
        Ros2Outlet::declare(&self.session, place, &board.unpublished).await
    }

    /// Declares the key of a camera's clip reports.
    async fn reports_publisher(
        &self,
        board: &CameraBoard,
    ) -> Result<AdvancedPublisher<'static>, NodeError> {
        self.session
            .declare_publisher(board.keys.clip())
            .congestion_control(CongestionControl::Drop)
            .priority(publishing::CLIPS)
            .cache(CacheConfig::default().max_samples(CACHED_REPORTS))
            .sample_miss_detection(MissDetectionConfig::default())
            .publisher_detection()
            .await
            .map_err(NodeError::refused("clip reports cannot be published"))
    }

    /// Feeds the camera from its key: puts, queries if every frame counts, and the tokens of its publishers.
    async fn subscribe(
        &self,
        delivery: Delivery,
        key: &str,
        receiver: Arc<FrameReceiver>,
        subscriptions: &mut Subscriptions,
    ) -> Result<(), NodeError> {
        let refused = || NodeError::refused(format!("frames on `{key}` cannot be received"));
        if delivery == Delivery::Every {
            let every_frame = Arc::clone(&receiver);
            let queryable = self
                .session
                .declare_queryable(key.to_owned())
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
                let Some(stream) = stream_of_token(token.key_expr().as_str()) else {
                    return;
                };
                match token.kind() {
                    SampleKind::Put => publishers.publisher_came(stream),
                    SampleKind::Delete => publishers.publisher_left(stream),
                }
            })
            .await
            .map_err(refused())?;
        let frames = self
            .session
            .declare_subscriber(key.to_owned())
            .callback(move |sample| receiver.take(&sample))
            .await
            .map_err(refused())?;
        subscriptions.push(Box::new(tokens));
        subscriptions.push(Box::new(frames));
        Ok(())
    }

    /// Feeds the camera from a source that the node keeps open.
    async fn add_source(
        &self,
        board: &CameraBoard,
        receiver: Arc<FrameReceiver>,
        settings: SourceSettings,
        tasks: &mut Supervisor,
    ) -> Result<(), NodeError> {
        // On a blocking thread, because it runs the programs to read their versions.
        let search = tokio::task::spawn_blocking(move || LiveSource::find(settings));
        let found = search.await.map_err(NodeError::new)?.map_err(NodeError::new)?;
        let source = found.counting(Arc::clone(&board.input.arrivals));
        let name = board.name();
        let readiness = &self.board.readiness;
        let part = readiness.part_of(readiness::CAMERAS, name);
        let named = name.to_owned();
        let each = move |event| match event {
            SourceEvent::Picture(taken) => {
                if taken.is_reopened && taken.picture.is_ok() {
                    part.works();
                }
                receiver.take_picture(taken);
            }
            SourceEvent::PassedOver(file) => {
                tracing::warn!(camera = named, "passed over {file}");
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
        let evidence = LiveEvidence::new(
            self.models.detector.clone(),
            self.models.screen.clone(),
            EmptyRun::new(self.config.screen.longest_empty_run),
            slot,
            self.pixels.clone(),
            self.give_up.clone(),
        );
        let examiner = Examiner {
            detector: self.models.detector.clone(),
            pixels: self.pixels.clone(),
            energy: parts.energy.clone(),
            recorder: parts.recorder.clone(),
        };
        let board = Arc::clone(&parts.board);
        let examine =
            move |picture, shown, answer| examiner.clone().examine(picture, shown, answer).boxed();
        let audit = CameraAudit::new(self.config.audit, board, examine);
        let settings = self.config.loop_settings();
        Camera::new(parts, settings, evidence, audit)
    }
}
