//! Adds a camera to a node that starts: its publishers, its loop, its reporter, its threshold and its source of frames.

use super::{PolicyMaker, refused};
use crate::api::key_service::KeyService;
use crate::api::threshold::ThresholdKey;
use crate::camera::audit::{Auditor, CameraAudit};
use crate::camera::clip::{ClipTracker, ClosedClip};
use crate::camera::evidence::LiveEvidence;
use crate::camera::publishing::{self, Detections, Outlet};
use crate::camera::{AnswerTime, Camera, Decider, SettledStream};
use crate::config::{CameraConfig, NodeConfig};
use crate::delivery::report::Reporter;
use crate::error::NodeError;
use crate::input::receiver::{DropCounts, FrameReceiver, SequencedFrame, SourceFeed};
use crate::input::source::{LiveSource, SourceSettings};
use crate::input::{Delivery, Ring, RingLimits};
use crate::state::board::{Board, CameraBoard};
use crate::state::readiness;
use albireo_core::policy::MinConfidence;
use albireo_power::PowerHandle;
use albireo_service::readiness::Effect;
use albireo_service::supervise::Supervisor;
use albireo_vision::detector::{CameraSlot, DetectorHandle};
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::{CameraScreen, ScreenHandle};
use albireo_wire::{CameraKeys, stream_of_token, stream_tokens};
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::qos::CongestionControl;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};
use zenoh_ext::{AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

/// Clip reports a publisher keeps for clients that come late.
const CACHED_REPORTS: usize = 64;

/// The Zenoh subscribers and queryables that receive frames.
#[derive(Default)]
pub(super) struct Subscriptions {
    subscribers: Vec<zenoh::pubsub::Subscriber<()>>,
    /// For cameras that answer every frame.
    queryables: Vec<zenoh::query::Queryable<()>>,
}

impl Subscriptions {
    pub(super) fn undeclare(self) {
        for subscriber in self.subscribers {
            let _ = subscriber.undeclare().wait();
        }
        for queryable in self.queryables {
            let _ = queryable.undeclare().wait();
        }
    }
}

/// What all cameras share.
pub(super) struct Shared {
    pub(super) config: NodeConfig,
    pub(super) power: PowerHandle,
    pub(super) pixels: PixelWork,
    pub(super) detector: DetectorHandle,
    pub(super) screen: Option<ScreenHandle>,
    pub(super) policies: PolicyMaker,
    /// Once cancelled, no camera waits for the detector any more.
    pub(super) give_up: CancellationToken,
}

/// Adds cameras to a node that starts.
pub(super) struct Cameras<'a> {
    pub(super) shared: Arc<Shared>,
    pub(super) session: &'a Session,
    pub(super) board: &'a Arc<Board>,
    pub(super) tasks: &'a mut Supervisor,
    pub(super) subscriptions: Subscriptions,
    pub(super) shutdown: CancellationToken,
}

impl Cameras<'_> {
    pub(super) async fn add(
        &mut self,
        slot: CameraSlot,
        config: &CameraConfig,
        keys: &CameraKeys,
    ) -> Result<(), NodeError> {
        let board = self
            .board
            .camera(&config.name)
            .ok_or_else(|| NodeError::State("it is not on the board".to_owned()))?;
        let name = &config.name;
        let shared = Arc::clone(&self.shared);
        let drops = Arc::new(DropCounts::new(Arc::clone(board)));
        let ring = Arc::new(Ring::new(RingLimits::new(
            config.delivery,
            config.ring,
            shared.config.frame.max_payload_bytes,
        )));
        let (closed, clips) = mpsc::unbounded_channel();

        let detections = self.publisher(config, keys.detections(), board).await?;
        let late = match shared.config.answer_time(config) {
            AnswerTime::WhenKnown => None,
            AnswerTime::AtOnce => Some(self.publisher(config, keys.late(), board).await?),
        };
        let settled = match shared.config.settle.enabled {
            true => Some(self.publisher(config, keys.settled(), board).await?),
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
            .map_err(refused("clip reports cannot be published"))?;

        let audit = Arc::new(CameraAudit::new(
            shared.config.audit.draw(),
            shared.config.audit.share,
            Arc::clone(board),
        ));
        self.add_auditor(name, &audit);
        let factory = CameraFactory {
            shared: Arc::clone(&shared),
            config: config.clone(),
            slot,
            board: Arc::clone(board),
            drops: Arc::clone(&drops),
            ring: Arc::clone(&ring),
            audit,
            detections,
            late,
            settled,
            closed,
        };
        let (factory, stop) = (Arc::new(factory), self.shutdown.clone());
        self.tasks.restarting(
            format!("camera {name}"),
            tracing::info_span!("camera", name),
            Effect::NotReady,
            move || {
                let (factory, stop) = (Arc::clone(&factory), stop.clone());
                async move {
                    let camera = factory.build()?;
                    camera.run(stop).await;
                    Ok::<(), NodeError>(())
                }
            },
        );
        let reporter = Reporter {
            board: Arc::clone(self.board),
            camera: config.name.clone(),
            detector: shared.detector.clone(),
            listeners: reports,
        };
        self.tasks.essential(
            format!("reporter {name}"),
            tracing::info_span!("reporter", camera = name),
            reporter.run(clips),
        );

        let value = Arc::new(ThresholdKey(Arc::clone(board)));
        let threshold = KeyService::declare(self.session, keys.threshold(), value)
            .await
            .map_err(refused("the threshold cannot be served"))?;
        self.tasks.essential(
            format!("threshold {name}"),
            tracing::info_span!("threshold", camera = name),
            threshold.run(self.shutdown.clone()),
        );
        let receiver = FrameReceiver::new(
            Arc::clone(board),
            drops,
            ring,
            config.format,
            shared.config.frame,
        );
        if let Some(settings) = config.source_settings(shared.config.frame) {
            return self.add_source(name, receiver, settings).await;
        }
        let key = board.key();
        let refused = || refused(format!("frames on `{key}` cannot be received"));
        let receiver = Arc::new(receiver);
        if config.delivery == Delivery::Every {
            let every_frame = Arc::clone(&receiver);
            let queryable = self
                .session
                .declare_queryable(key.to_owned())
                .complete(true)
                .callback(move |query| every_frame.take_query(query))
                .await
                .map_err(refused())?;
            self.subscriptions.queryables.push(queryable);
        }
        let publishers = Arc::clone(&receiver);
        let tokens = self
            .session
            .liveliness()
            .declare_subscriber(stream_tokens(key))
            .callback(move |token| {
                if let Some(stream) = stream_of_token(token.key_expr().as_str()) {
                    publishers.publisher_changed(stream, token.kind() == SampleKind::Delete);
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
        self.subscriptions.subscribers.extend([tokens, frames]);
        Ok(())
    }

    /// A publisher of a camera's answers: a replay loses none.
    async fn publisher(
        &mut self,
        config: &CameraConfig,
        key: String,
        board: &CameraBoard,
    ) -> Result<Arc<Detections>, NodeError> {
        let (congestion, priority) = match config.delivery {
            Delivery::Newest => (CongestionControl::Drop, publishing::LIVE),
            Delivery::Every => (CongestionControl::Block, publishing::EVERY),
        };
        let publisher = self
            .session
            .declare_publisher(key.clone())
            .congestion_control(congestion)
            .priority(priority)
            .await
            .map_err(refused(format!("`{key}` cannot be published")))?;
        let outlet = Outlet::new(publisher, board.unpublished());
        Ok(Arc::new(match config.delivery {
            Delivery::Newest => Detections::Live(outlet),
            Delivery::Every => {
                let (detections, thread) = Detections::every(outlet);
                let span = tracing::info_span!("detections", key);
                self.tasks
                    .essential(format!("publisher {key}"), span, async move {
                        thread.await.map_err(|error| error.to_string())
                    });
                detections
            }
        }))
    }

    /// Runs the detector on some of the camera's skipped frames, after their answers.
    fn add_auditor(&mut self, name: &str, audit: &Arc<CameraAudit>) {
        if audit.share().is_none() {
            return;
        }
        let shared = &self.shared;
        let auditor = Auditor {
            audit: Arc::clone(audit),
            detector: shared.detector.clone(),
            screen: shared.screen.as_ref().map(ScreenHandle::input_format),
            pixels: shared.pixels.clone(),
            energy: shared.power.camera(name),
        };
        self.tasks.essential(
            format!("audit {name}"),
            tracing::info_span!("audit", camera = name),
            auditor.run(self.shutdown.clone()),
        );
    }

    /// Feeds the camera from a source that the node keeps open.
    async fn add_source(
        &mut self,
        name: &str,
        receiver: FrameReceiver,
        settings: SourceSettings,
    ) -> Result<(), NodeError> {
        // It asks the programs for their versions.
        let found = tokio::task::spawn_blocking(move || LiveSource::find(settings)).await;
        let source = found.map_err(|error| NodeError::State(error.to_string()))??;
        let readiness = self.board.readiness();
        let part = readiness.part_of(readiness::CAMERAS, name.to_owned());
        let feed = SourceFeed {
            source: Arc::new(source),
            receiver: Arc::new(receiver),
            part,
        };
        let stop = self.shutdown.clone();
        self.tasks.restarting(
            format!("source {name}"),
            tracing::info_span!("source", camera = name),
            Effect::Degraded,
            move || feed.clone().run(stop.clone()),
        );
        Ok(())
    }
}

/// Builds a camera's loop, at its start and whenever it has failed.
struct CameraFactory {
    shared: Arc<Shared>,
    config: CameraConfig,
    slot: CameraSlot,
    board: Arc<CameraBoard>,
    drops: Arc<DropCounts>,
    ring: Arc<Ring<SequencedFrame>>,
    audit: Arc<CameraAudit>,
    detections: Arc<Detections>,
    /// Only where frames are answered at once.
    late: Option<Arc<Detections>>,
    settled: Option<Arc<Detections>>,
    closed: mpsc::UnboundedSender<ClosedClip>,
}

impl CameraFactory {
    /// A loop that knows nothing of earlier frames and begins a new clip. It takes over the threshold in force with its
    /// first frame.
    fn build(&self) -> Result<Camera, NodeError> {
        let Shared {
            config, detector, ..
        } = &*self.shared;
        let policy = (self.shared.policies)(&self.config.name)?;
        let evidence = LiveEvidence::new(
            detector.clone(),
            CameraScreen::new(&config.screen, self.shared.screen.clone()),
            self.slot,
            self.shared.pixels.clone(),
        )
        .giving_up_on(self.shared.give_up.clone());
        let decider = match self.late {
            Some(_) => Decider::at_once(policy, evidence)
                .map_err(|error| NodeError::State(error.to_string()))?,
            None => Decider::when_known(policy, evidence),
        };
        let class_names: Arc<[String]> = detector.class_names().into();
        let min_confidence =
            MinConfidence::new(config.report.confidence, config.detector.confidence);
        let settled = self.settled.as_ref().map(|publisher| {
            SettledStream::new(
                config.settle.longest(),
                Arc::clone(publisher),
                min_confidence,
                Arc::clone(&class_names),
            )
        });
        self.ring.open();
        let energy = self.shared.power.camera(&self.config.name);
        let mut clip = ClipTracker::new(config.clip, energy);
        if let Some(share) = self.audit.share() {
            clip = clip.audited_with(share);
        }
        Ok(Camera {
            board: Arc::clone(&self.board),
            ring: Arc::clone(&self.ring),
            drops: Arc::clone(&self.drops),
            decider,
            detections: Arc::clone(&self.detections),
            late: self.late.clone(),
            settled,
            min_confidence,
            class_names,
            clip,
            closed: self.closed.clone(),
            audit: Arc::clone(&self.audit),
            reset_at_clip: self.config.reset_at_clip,
        })
    }
}
