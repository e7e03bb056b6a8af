//! Starts the parts of a node in a fixed order, and stops them in the opposite one.

use crate::api::key_service::KeyService;
use crate::api::name::NodeName;
use crate::api::threshold::ThresholdKey;
use crate::camera::audit::{Auditor, CameraAudit};
use crate::camera::clip::{ClipTracker, ClosedClip};
use crate::camera::evidence::LiveEvidence;
use crate::camera::publishing::{self, Detections, PublishingThread};
use crate::camera::{AnswerTime, AtOnce, Camera, Decider, SettledStream};
use crate::config::{CameraConfig, NodeConfig};
use crate::delivery::report::{ClipAccounts, Reporter};
use crate::delivery::uplink::{DesiredKeeper, Uplink, UplinkSetup};
use crate::error::NodeError;
use crate::input::receiver::{DropCounts, FrameReceiver, SequencedFrame, SourceFeed};
use crate::input::source::{LiveSource, SourceSettings};
use crate::input::{Delivery, RingLimits, RingReceiver, RingSender, frame_ring};
use crate::state::board::{Board, BoardSetup, CameraBoard};
use crate::state::counters::Counters;
use crate::state::readiness;
use crate::state::target::{TargetKey, TargetTask};
use albireo_core::policy::{MinConfidence, Policy, PolicyConfigError};
use albireo_power::PowerHandle;
use albireo_service::readiness::{Effect, Fault, Latch};
use albireo_service::session;
use albireo_service::supervise::Supervisor;
use albireo_vision::detector::{CameraSlot, DetectorHandle, DetectorStatus};
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::{CameraScreen, ScreenHandle};
use albireo_wire::{CameraKeys, NodeKeys, stream_of_token, stream_tokens};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, mpsc, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use zenoh::qos::CongestionControl;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};
use zenoh_ext::{AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

/// Clip reports a publisher keeps for clients that come late.
const CACHED_REPORTS: usize = 64;

/// Answers of a live camera that may wait to be published; beyond it the oldest go.
const WAITING_ANSWERS: usize = 8;

/// Settled frames of a live camera that may wait to be published: those held back go out together.
const WAITING_SETTLED: usize = 512;

/// Interval at which the state of parts that report nothing by themselves is read.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// How long the last messages for subscribers may take.
const FLUSH_LIMIT: Duration = Duration::from_secs(1);

/// Makes a camera's policy, at its start and whenever its loop has failed: `|camera| policy`.
pub type PolicyMaker =
    Arc<dyn Fn(&str) -> Result<Box<dyn Policy>, PolicyConfigError> + Send + Sync>;

/// A running node.
pub struct Node {
    session: Session,
    detector: DetectorHandle,
    screen: Option<ScreenHandle>,
    /// All tasks: they end by themselves after the shutdown token is cancelled.
    tasks: Supervisor,
    /// Once cancelled, camera loops wait for no detector any more.
    hurry: CancellationToken,
    stop_timeout: Duration,
    /// Power sampler: stopped when the last report is out.
    sampling: CancellationToken,
    alive: NodeName,
    publishing: PublishingThread,
    uplink: Uplink,
    subscriptions: Subscriptions,
    shutdown: CancellationToken,
}

/// A node before it is started: its board can be shown already, and says that it is not ready.
pub struct PreparedNode {
    board: Arc<Board>,
    /// Keeps the node from being ready until the cameras are heard.
    starting: Latch,
    detector_status: watch::Sender<DetectorStatus>,
    policies: PolicyMaker,
}

impl fmt::Debug for PreparedNode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PreparedNode")
            .field("board", &self.board)
            .finish_non_exhaustive()
    }
}

impl PreparedNode {
    /// Makes the board of a node with this configuration.
    ///
    /// # Errors
    /// When a name or the policy cannot be used.
    pub fn new(config: &NodeConfig) -> Result<Self, NodeError> {
        let (detector_status, status) = watch::channel(DetectorStatus::Starting);
        let board = Board::new(BoardSetup::from_config(config, status)?);
        let starting = board
            .readiness()
            .latch(readiness::CAMERAS, "the cameras are not subscribed to yet");
        let policy = config.policy.clone();
        Ok(Self {
            board,
            starting,
            detector_status,
            policies: Arc::new(move |_| policy.build()),
        })
    }

    /// Lets `policies` decide instead of those the configuration names, for a program that brings its own.
    /// They should have the configured policy's knob.
    #[must_use]
    pub fn with_policies(mut self, policies: PolicyMaker) -> Self {
        self.policies = policies;
        self
    }

    /// What the node shows of itself.
    pub fn board(&self) -> &Arc<Board> {
        &self.board
    }

    /// Starts the node and returns when its cameras can be heard. It runs until `shutdown` is cancelled;
    /// then call [`Node::stopped`]. `None` when `shutdown` is cancelled before: a model may take minutes to
    /// load, or for ever.
    ///
    /// # Errors
    /// When a part cannot start: the message says which, and what to do.
    pub async fn start(
        self,
        config: &NodeConfig,
        shutdown: CancellationToken,
    ) -> Result<Option<Node>, NodeError> {
        tokio::select! {
            biased;
            node = self.start_parts(config, shutdown.clone()) => node.map(Some),
            () = shutdown.cancelled() => {
                tracing::info!("stopped before the node was ready");
                Ok(None)
            }
        }
    }

    async fn start_parts(
        self,
        config: &NodeConfig,
        shutdown: CancellationToken,
    ) -> Result<Node, NodeError> {
        let Self {
            board,
            starting,
            detector_status,
            policies,
        } = self;
        let keys = NodeKeys::new(&config.node.prefix, &config.node.name)?;
        let zenoh = board.readiness().part(readiness::ZENOH);
        zenoh.not_ready("the session is not open yet");
        let session = session::open(&config.zenoh, config.frame.max_payload_bytes, |reason| {
            zenoh.not_ready(reason);
        })
        .await
        .map_err(|error| NodeError::Zenoh(format!("{error:#}")))?;
        zenoh.works();
        let opened = session.clone();
        (board.readiness()).probe(readiness::ZENOH, readiness::ZENOH_SESSION, move || {
            (opened.is_closed()).then(|| Fault::not_ready("it is closed"))
        });
        let publishing = PublishingThread::start().map_err(|source| NodeError::System {
            what: "the publishing thread cannot be started",
            source,
        })?;
        let sampling = CancellationToken::new();
        let unless_started = sampling.clone().drop_guard();
        let (power, sampler) = albireo_power::start(&config.power, sampling.clone()).await?;
        tracing::info!(model = %config.detector.model.display(), "loading the detector");
        let detector = DetectorHandle::start(&config.detector)
            .await
            .map_err(NodeError::Detector)?;
        let screen = ScreenHandle::start(&config.screen, config.detector.onnxruntime.as_deref())
            .await
            .map_err(NodeError::Screen)?;

        if let Some(screen) = &screen {
            let status = screen.status();
            (board.readiness()).probe(readiness::SCREEN, "", move || {
                readiness::of_screen(&status.borrow())
            });
        }
        board.attach_meters(detector.meter(), screen.as_ref().map(ScreenHandle::meter));
        let mut tasks = Supervisor::new(
            board.readiness().clone(),
            board.tasks().clone(),
            shutdown.clone(),
        );
        tasks.until_shutdown(
            "detector status",
            tracing::info_span!("detector_status"),
            follow(detector.status(), detector_status),
        );
        let ended = detector.clone();
        tasks.until_shutdown("detector", tracing::info_span!("detector"), async move {
            ended.ended().await
        });
        if let Some(ended) = screen.clone() {
            tasks.until_shutdown("screen", tracing::info_span!("screen"), async move {
                ended.ended().await
            });
        }
        readiness::look_at_cameras(&board, readiness::CAMERA_SILENCE);
        readiness::look_at_power(&board, &power);
        let watched = board.readiness().clone();
        tasks.until_shutdown("readiness", tracing::info_span!("readiness"), async move {
            watched.watch(LOOK_EVERY).await;
        });
        tasks.until_shutdown("power sampler", tracing::info_span!("power"), sampler);
        let hurry = CancellationToken::new();
        let mut parts = Parts {
            shared: Arc::new(Shared {
                config: config.clone(),
                power: power.clone(),
                pixels: PixelWork::new(
                    detector.preparation().clone(),
                    config.frame,
                    config.detector.batch_size,
                ),
                detector: detector.clone(),
                screen: screen.clone(),
                policies,
                hurry: hurry.clone(),
            }),
            session: &session,
            board: &board,
            publishing: &publishing,
            tasks,
            subscriptions: Subscriptions::default(),
            shutdown: shutdown.clone(),
        };
        for (slot, camera) in config.cameras.iter().enumerate() {
            let camera_keys = keys.camera(&camera.name)?;
            parts
                .add_camera(CameraSlot(slot), camera, &camera_keys)
                .await
                .map_err(|error| NodeError::Camera {
                    camera: camera.name.clone(),
                    error: Box::new(error),
                })?;
        }
        let counters = Counters::declare(
            &session,
            &publishing,
            &keys,
            Arc::clone(&board),
            power.clone(),
        )
        .await?;
        parts.tasks.essential(
            "counters",
            tracing::info_span!("counters"),
            counters.run(shutdown.clone()),
        );
        parts.add_target(keys.target()).await?;
        let Parts {
            mut tasks,
            subscriptions,
            ..
        } = parts;
        let alive = NodeName::default();
        let holding = alive.clone().hold(
            session.clone(),
            keys.fleet().alive(),
            board.readiness().part_of(readiness::ZENOH, "name"),
        );
        tasks.until_shutdown("name", tracing::info_span!("name"), holding);
        let (uplink, ended) = Uplink::start(UplinkSetup {
            board: Arc::clone(&board),
            config: config.clone(),
            keys: keys.fleet(),
            desired: DesiredKeeper::open(board.outbox()),
            local: (!config.uplink.is_set()).then(|| session.clone()),
        });
        tasks.until_shutdown("uplink", tracing::info_span!("uplink"), ended);
        drop(starting);
        Ok(Node {
            session,
            detector,
            screen,
            tasks,
            hurry,
            stop_timeout: config.node.stop_timeout(),
            sampling: unless_started.disarm(),
            alive,
            publishing,
            uplink,
            subscriptions,
            shutdown,
        })
    }
}

impl Node {
    /// Where the node's Zenoh session really listens: the ports of endpoints that were configured with
    /// port 0 are known only now.
    pub async fn endpoints(&self) -> Vec<String> {
        let locators = self.session.info().locators().await;
        locators.iter().map(ToString::to_string).collect()
    }

    /// The execution provider that really runs the detector, as far as it is known.
    pub fn provider(&self) -> Option<&'static str> {
        crate::api::http::provider(&self.detector.status().borrow())
    }

    /// Runs until the shutdown token is cancelled or a task fails that the node cannot do without. Then lets the
    /// current frames and open clips out, and closes. Takes at most 5 s,
    /// whatever hangs: after a quarter of it no detector is waited for, and what has not ended in time is named in
    /// the log and given up.
    ///
    /// # Errors
    /// [`NodeError::Task`] when it ended because of a task.
    pub async fn stopped(mut self) -> Result<(), NodeError> {
        let watched = self.tasks.watch().await;
        // Of a task that failed the others hear now.
        self.shutdown.cancel();
        let start = Instant::now();
        // What is left of the time is for HTTP and for threads that are still at work.
        let (tasks_until, until) = (
            start + self.stop_timeout / 2,
            start + self.stop_timeout * 3 / 4,
        );
        let hurry = self.hurry.clone();
        let hurrying = async {
            tokio::time::sleep(self.stop_timeout / 4).await;
            hurry.cancel();
            std::future::pending().await
        };
        let subscriptions = std::mem::take(&mut self.subscriptions);
        // Zenoh's calls may block, so each gets a thread.
        let undeclared = tokio::task::spawn_blocking(move || {
            subscriptions.undeclare();
        });
        let ending = tokio::select! {
            ended = tokio::time::timeout_at(tasks_until, async {
                let (_, ()) = tokio::join!(undeclared, self.tasks.finish());
            }) => ended,
            () = hurrying => Ok(()),
        };
        if ending.is_err() {
            tracing::error!(
                tasks = ?self.tasks.still_running(),
                "not everything ended in time: it is given up"
            );
        }
        // The sampler is the last of the tasks: the clips' energy comes from it.
        self.sampling.cancel();
        let (alive, session) = (self.alive.take().await, self.session);
        let (uplink, publishing) = (self.uplink, self.publishing);
        let closed = async move {
            let flushed = tokio::task::spawn_blocking(move || {
                publishing.flush(std::time::Instant::now() + FLUSH_LIMIT);
            });
            let _ = flushed.await;
            uplink.stop().await;
            for token in alive {
                let _ = token.undeclare().await;
            }
            session.close().await
        };
        let closing = async {
            let screen = async {
                if let Some(screen) = &self.screen {
                    screen.stop().await;
                }
            };
            let (closed, (), ()) = tokio::join!(closed, self.detector.stop(), screen);
            if let Err(error) = closed {
                tracing::warn!(%error, "Zenoh session not closed cleanly");
            }
        };
        if tokio::time::timeout_at(until, closing).await.is_err() {
            tracing::error!("the detector or the Zenoh session did not end in time: given up");
        }
        tracing::info!(
            seconds = albireo_service::clock::seconds(start.elapsed()),
            "stopped"
        );
        Ok(watched?)
    }
}

/// For what Zenoh refuses.
fn refused(what: impl fmt::Display) -> impl FnOnce(zenoh::Error) -> NodeError {
    move |error| NodeError::Zenoh(format!("{what}: {}", session::plain(&error)))
}

/// Where frames come in.
#[derive(Default)]
struct Subscriptions {
    subscribers: Vec<zenoh::pubsub::Subscriber<()>>,
    /// Of the cameras that are to miss no frame.
    queryables: Vec<zenoh::query::Queryable<()>>,
}

impl Subscriptions {
    fn undeclare(self) {
        for subscriber in self.subscribers {
            let _ = subscriber.undeclare().wait();
        }
        for queryable in self.queryables {
            let _ = queryable.undeclare().wait();
        }
    }
}

/// What all cameras are made from.
struct Shared {
    config: NodeConfig,
    power: PowerHandle,
    pixels: PixelWork,
    detector: DetectorHandle,
    screen: Option<ScreenHandle>,
    policies: PolicyMaker,
    hurry: CancellationToken,
}

/// Where the cameras are added, and what has been made so far.
struct Parts<'a> {
    shared: Arc<Shared>,
    session: &'a Session,
    board: &'a Arc<Board>,
    publishing: &'a PublishingThread,
    tasks: Supervisor,
    subscriptions: Subscriptions,
    shutdown: CancellationToken,
}

impl Parts<'_> {
    async fn add_camera(
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
        let (sender, ring) = frame_ring(RingLimits::new(
            config.delivery,
            config.ring,
            shared.config.frame.max_payload_bytes,
        ));
        let (closed, clips) = mpsc::unbounded_channel();

        let detections = self
            .publisher(config, keys.detections(), WAITING_ANSWERS, board)
            .await?;
        let late = match shared.config.answer_time(config) {
            AnswerTime::WhenKnown => None,
            AnswerTime::AtOnce => Some(
                self.publisher(config, keys.late(), WAITING_ANSWERS, board)
                    .await?,
            ),
        };
        let settled = match shared.config.settle.enabled {
            true => Some(
                self.publisher(config, keys.settled(), WAITING_SETTLED, board)
                    .await?,
            ),
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
        let maker = CameraMaker {
            shared: Arc::clone(&shared),
            config: config.clone(),
            slot,
            board: Arc::clone(board),
            drops: Arc::clone(&drops),
            first_ring: Mutex::new(Some(ring)),
            sender: sender.clone(),
            audit,
            detections,
            late,
            settled,
            closed,
        };
        let (maker, stop) = (Arc::new(maker), self.shutdown.clone());
        self.tasks.restarting(
            format!("camera {name}"),
            tracing::info_span!("camera", name),
            Effect::NotReady,
            move || {
                let (maker, stop) = (Arc::clone(&maker), stop.clone());
                async move {
                    let camera = maker.make().await?;
                    camera.run(stop).await;
                    Ok::<(), NodeError>(())
                }
            },
        );
        let reporter = Reporter {
            board: Arc::clone(self.board),
            camera: config.name.clone(),
            detector: shared.detector.clone(),
            listeners: self
                .publishing
                .lane(reports, CACHED_REPORTS, board.unpublished()),
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
            sender,
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
            let asked = Arc::clone(&receiver);
            let queryable = self
                .session
                .declare_queryable(key.to_owned())
                .complete(true)
                .callback(move |query| asked.take_query(query))
                .await
                .map_err(refused())?;
            self.subscriptions.queryables.push(queryable);
        }
        let watching = Arc::clone(&receiver);
        let tokens = self
            .session
            .liveliness()
            .declare_subscriber(stream_tokens(key))
            .callback(move |token| {
                if let Some(stream) = stream_of_token(token.key_expr().as_str()) {
                    watching.publisher_changed(stream, token.kind() == SampleKind::Delete);
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
}

impl Parts<'_> {
    /// A publisher of a camera's answers, of which at most `waiting` wait. Those of a live camera age with its frames; a replay wants each of them.
    async fn publisher(
        &mut self,
        config: &CameraConfig,
        key: String,
        waiting: usize,
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
        Ok(Arc::new(match config.delivery {
            Delivery::Newest => Detections::Live(self.publishing.lane(
                publisher,
                waiting,
                board.unpublished(),
            )),
            Delivery::Every => {
                let (detections, thread) = Detections::every(publisher, board.unpublished());
                let span = tracing::info_span!("detections", key);
                self.tasks
                    .essential(format!("publisher {key}"), span, async move {
                        thread.await.map_err(|error| error.to_string())
                    });
                detections
            }
        }))
    }

    /// Serves the node's target on its key and holds it.
    async fn add_target(&mut self, key: String) -> Result<(), NodeError> {
        let value = Arc::new(TargetKey(Arc::clone(self.board)));
        let served = KeyService::declare(self.session, key, value)
            .await
            .map_err(refused("the target cannot be served"))?;
        self.tasks.essential(
            "target requests",
            tracing::info_span!("target_requests"),
            served.run(self.shutdown.clone()),
        );
        let task = TargetTask::new(Arc::clone(self.board), self.shared.power.clone());
        self.tasks.essential(
            "target",
            tracing::info_span!("target"),
            task.run(self.shutdown.clone()),
        );
        Ok(())
    }

    /// Has some of the camera's skipped frames looked at afterwards.
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

/// What a camera's loop is made from, as often as that is needed.
struct CameraMaker {
    shared: Arc<Shared>,
    config: CameraConfig,
    slot: CameraSlot,
    board: Arc<CameraBoard>,
    drops: Arc<DropCounts>,
    /// The ring as it was made: no frame between that and the loop's start is lost.
    first_ring: Mutex<Option<RingReceiver<SequencedFrame>>>,
    sender: RingSender<SequencedFrame>,
    audit: Arc<CameraAudit>,
    detections: Arc<Detections>,
    /// Only where frames are answered at once.
    late: Option<Arc<Detections>>,
    settled: Option<Arc<Detections>>,
    closed: mpsc::UnboundedSender<ClosedClip>,
}

impl CameraMaker {
    /// A loop that knows nothing of the frames before; the clip begins again with it. The loop takes over the
    /// threshold in force with its first frame.
    async fn make(&self) -> Result<Camera, NodeError> {
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
        .hurried_by(self.shared.hurry.clone());
        let decider = if self.late.is_some() {
            let at_once = AtOnce::new(policy, evidence)
                .map_err(|error| NodeError::State(error.to_string()))?;
            Decider::AtOnce(Box::new(at_once))
        } else {
            Decider::WhenKnown {
                policy,
                evidence: Box::new(evidence),
            }
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
        let ring = self.first_ring.lock().await.take();
        let energy = self.shared.power.camera(&self.config.name);
        let mut tracker = ClipTracker::new(config.clip, energy);
        if let Some(share) = self.audit.share() {
            tracker = tracker.audited_with(share);
        }
        Ok(Camera {
            board: Arc::clone(&self.board),
            ring: ring.unwrap_or_else(|| self.sender.reopen()),
            drops: Arc::clone(&self.drops),
            decider,
            detections: Arc::clone(&self.detections),
            late: self.late.clone(),
            settled,
            min_confidence,
            class_names,
            accounts: ClipAccounts::new(
                tracker,
                Arc::clone(&self.drops),
                Arc::clone(&self.audit),
                self.closed.clone(),
            ),
            audit: Arc::clone(&self.audit),
            reset_at_clip: self.config.reset_at_clip,
        })
    }
}

/// Copies the detector's status to where the board reads it.
async fn follow(mut from: watch::Receiver<DetectorStatus>, to: watch::Sender<DetectorStatus>) {
    loop {
        to.send_replace(from.borrow_and_update().clone());
        if from.changed().await.is_err() {
            return;
        }
    }
}
