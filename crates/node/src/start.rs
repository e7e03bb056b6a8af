//! Starts the parts of a node in a fixed order, and stops them in the opposite one.

use super::board::{Board, BoardSetup};
use super::camera::Camera;
use super::config::{CameraConfig, NodeConfig};
use super::counters::Counters;
use super::evidence::LiveEvidence;
use super::intake::{DropCounts, Intake};
use super::report::{ClipAccounts, Reporter};
use super::threshold::ThresholdService;
use crate::clip::ClipTracker;
use crate::detector::{CameraSlot, DetectorHandle, DetectorStatus};
use crate::frame::{Delivery, frame_ring};
use crate::power::{self, PowerHandle};
use crate::publishing::{self, Detections, PublishingThread};
use crate::readiness;
use crate::screen::{CameraScreen, ScreenHandle};
use crate::uplink::{DesiredKeeper, Uplink, UplinkSetup, Way};
use albireo_service::readiness::Latch;
use albireo_service::session;
use albireo_wire::{CameraKeys, NodeKeys};
use anyhow::{Context, anyhow};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh_ext::{AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

/// Clip reports a publisher keeps for clients that come late.
const CACHED_REPORTS: usize = 64;

/// Answers of a live camera that may wait to be published; beyond it the oldest go.
const WAITING_ANSWERS: usize = 8;

/// How long stopping may take in all: longer, and what is not out yet is given up. A service manager's
/// patience is longer than that.
const STOP_LIMIT: Duration = Duration::from_millis(4500);

/// How long the last messages for whoever listens may take.
const FLUSH_LIMIT: Duration = Duration::from_secs(1);

/// A running node.
pub struct Node {
    session: Session,
    detector: DetectorHandle,
    screen: Option<ScreenHandle>,
    /// Camera loops and reporters: they end by themselves after the shutdown token is cancelled.
    working: JoinSet<()>,
    /// Power sampler: stopped when the last report is out.
    sampling: CancellationToken,
    alive: LivelinessToken,
    publishing: PublishingThread,
    uplink: Uplink,
    intakes: Vec<zenoh::pubsub::Subscriber<()>>,
    _thresholds: Vec<ThresholdService>,
    shutdown: CancellationToken,
}

/// A node before it is started: its board can be shown already, and says that it is not ready.
#[derive(Debug)]
pub struct PreparedNode {
    board: Arc<Board>,
    /// Keeps the node from being ready until the cameras are heard.
    starting: Latch,
    detector_status: watch::Sender<DetectorStatus>,
}

impl PreparedNode {
    /// Makes the board of a node with this configuration.
    ///
    /// # Errors
    /// When a name or the policy cannot be used.
    pub fn new(config: &NodeConfig) -> anyhow::Result<Self> {
        let (detector_status, status) = watch::channel(DetectorStatus::Starting);
        let board = Board::new(BoardSetup::from_config(config, status)?);
        let starting = board
            .readiness()
            .latch(readiness::CAMERAS, "the cameras are not subscribed to yet");
        Ok(Self {
            board,
            starting,
            detector_status,
        })
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
    ) -> anyhow::Result<Option<Node>> {
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
    ) -> anyhow::Result<Node> {
        let Self {
            board,
            starting,
            detector_status,
        } = self;
        let keys = NodeKeys::new(&config.node.prefix, &config.node.name)?;
        let zenoh = board.readiness().part(readiness::ZENOH);
        zenoh.not_ready("the session is not open yet");
        let session = session::open(&config.zenoh, config.frame.max_payload_bytes, |reason| {
            zenoh.not_ready(reason);
        })
        .await?;
        zenoh.works();
        let publishing = PublishingThread::start().context("the publishing thread")?;
        let sampling = CancellationToken::new();
        let unless_started = sampling.clone().drop_guard();
        let (power, _) = power::start(&config.power, sampling).await?;
        tracing::info!(model = %config.detector.model.display(), "loading the detector");
        let detector = DetectorHandle::start(&config.detector)
            .await
            .context("[detector]")?;
        let screen = ScreenHandle::start(&config.screen, config.detector.onnxruntime.as_deref())
            .await
            .context("[screen]")?;

        if let Some(screen) = &screen {
            let status = screen.status();
            (board.readiness()).probe(readiness::SCREEN, "", move || {
                readiness::of_screen(&status.borrow())
            });
        }
        board.attach_detector(detector.meter());
        tokio::spawn(follow(detector.status(), detector_status));
        let mut parts = Parts {
            config,
            session: &session,
            power: &power,
            detector: &detector,
            screen: screen.as_ref(),
            board: &board,
            publishing: &publishing,
            working: JoinSet::new(),
            intakes: Vec::new(),
            thresholds: Vec::new(),
            shutdown: shutdown.clone(),
        };
        for (slot, camera) in config.cameras.iter().enumerate() {
            let camera_keys = keys.camera(&camera.name)?;
            parts
                .add_camera(CameraSlot(slot), camera, &camera_keys)
                .await
                .with_context(|| format!("camera `{}`", camera.name))?;
        }
        let counters = Counters::declare(
            &session,
            &publishing,
            &keys,
            Arc::clone(&board),
            power.clone(),
        )
        .await?;
        parts.working.spawn(counters.run(shutdown.clone()));
        let Parts {
            working,
            intakes,
            thresholds,
            ..
        } = parts;
        let alive = session
            .liveliness()
            .declare_token(keys.fleet().alive())
            .await
            .map_err(|error| anyhow!("liveliness token not declared: {error}"))?;
        let uplink = Uplink::start(UplinkSetup {
            board: Arc::clone(&board),
            outbox: board.outbox().clone(),
            config: config.outbox.clone(),
            keys: keys.fleet(),
            labels: config.node.labels.clone(),
            desired: DesiredKeeper::open(board.outbox(), config.node.hub_wins),
            way: if config.uplink.is_set() {
                Way::Own(config.uplink.clone())
            } else {
                Way::Local(session.clone())
            },
        })
        .context("the uplink's thread")?;
        drop(starting);
        Ok(Node {
            session,
            detector,
            screen,
            working,
            sampling: unless_started.disarm(),
            alive,
            publishing,
            uplink,
            intakes,
            _thresholds: thresholds,
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

    /// Waits for the shutdown token, lets the frames in hand and the open clips out, and closes.
    /// Gives up after five seconds; what is not out then is in the spool or lost, and logged.
    pub async fn stopped(mut self) {
        self.shutdown.cancelled().await;
        let start = Instant::now();
        for intake in self.intakes.drain(..) {
            let _ = intake.undeclare().await;
        }
        let flush = async {
            while let Some(ended) = self.working.join_next().await {
                if let Err(error) = ended {
                    tracing::error!(%error, "a part of the node failed");
                }
            }
            self.detector.stop().await;
            if let Some(screen) = &self.screen {
                screen.stop().await;
            }
            let (uplink, publishing) = (self.uplink, self.publishing);
            let last_words = tokio::task::spawn_blocking(move || {
                publishing.flush(std::time::Instant::now() + FLUSH_LIMIT);
                uplink.stop();
            });
            if let Err(error) = last_words.await {
                tracing::error!(%error, "the last messages failed");
            }
            let _ = self.alive.undeclare().await;
            if let Err(error) = self.session.close().await {
                tracing::warn!(%error, "Zenoh session not closed cleanly");
            }
        };
        if tokio::time::timeout(STOP_LIMIT, flush).await.is_err() {
            tracing::error!("not everything could be published before the end");
        }
        self.sampling.cancel();
        tracing::info!(seconds = start.elapsed().as_secs_f64(), "stopped");
    }
}

/// What the cameras are made from, and what has been made so far.
struct Parts<'a> {
    config: &'a NodeConfig,
    session: &'a Session,
    power: &'a PowerHandle,
    detector: &'a DetectorHandle,
    screen: Option<&'a ScreenHandle>,
    board: &'a Arc<Board>,
    publishing: &'a PublishingThread,
    working: JoinSet<()>,
    intakes: Vec<zenoh::pubsub::Subscriber<()>>,
    thresholds: Vec<ThresholdService>,
    shutdown: CancellationToken,
}

impl Parts<'_> {
    async fn add_camera(
        &mut self,
        slot: CameraSlot,
        config: &CameraConfig,
        keys: &CameraKeys,
    ) -> anyhow::Result<()> {
        let board = self
            .board
            .camera(&config.name)
            .ok_or_else(|| anyhow!("not on the board"))?;
        let drops = Arc::new(DropCounts::new(Arc::clone(board)));
        let (sender, ring) = frame_ring(config.delivery, config.ring);
        let (accounts, closed) = ClipAccounts::new(
            ClipTracker::new(self.config.clip, self.power.user(&config.name)),
            Arc::clone(&drops),
        );

        // A live camera's answers age with its frames; a replay wants each of them.
        let (congestion, priority) = match config.delivery {
            Delivery::Newest => (CongestionControl::Drop, publishing::LIVE),
            Delivery::Every => (CongestionControl::Block, publishing::EVERY),
        };
        let detections = self
            .session
            .declare_publisher(keys.detections())
            .congestion_control(congestion)
            .priority(priority)
            .await
            .map_err(|error| anyhow!("detections cannot be published: {error}"))?;
        let detections = match config.delivery {
            Delivery::Newest => Detections::Live(self.publishing.lane(detections, WAITING_ANSWERS)),
            Delivery::Every => {
                let (detections, thread) = Detections::every(detections);
                self.working.spawn(async move {
                    let _ = thread.await;
                });
                detections
            }
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
            .map_err(|error| anyhow!("clip reports cannot be published: {error}"))?;

        let mut policy = self.config.policy.build()?;
        if let Some(threshold) = board.threshold() {
            policy.set_knob(threshold)?;
        }
        let camera = Camera {
            board: Arc::clone(board),
            ring,
            ledger: Arc::clone(&drops),
            policy,
            evidence: LiveEvidence::new(
                self.detector.clone(),
                CameraScreen::new(&self.config.screen, self.screen.cloned(), slot),
                slot,
                self.config.frame,
            ),
            detections,
            class_names: self.detector.class_names().into(),
            accounts,
            reset_at_clip: config.reset_at_clip,
        };
        let reporter = Reporter {
            board: Arc::clone(self.board),
            camera: config.name.clone(),
            detector: self.detector.clone(),
            listeners: self.publishing.lane(reports, CACHED_REPORTS),
            outbox: self.board.outbox().clone(),
        };
        self.working.spawn(camera.run(self.shutdown.clone()));
        self.working.spawn(reporter.run(closed));

        let threshold =
            ThresholdService::declare(self.session, keys.threshold(), Arc::clone(board))
                .await
                .map_err(|error| anyhow!("the threshold cannot be served: {error}"))?;
        self.thresholds.push(threshold);
        let intake = Intake::new(
            Arc::clone(board),
            drops,
            sender,
            config.format,
            self.config.frame,
        );
        let subscriber = self
            .session
            .declare_subscriber(board.key().to_owned())
            .callback(move |sample| intake.take(&sample))
            .await
            .map_err(|error| anyhow!("frames on `{}` cannot be had: {error}", board.key()))?;
        self.intakes.push(subscriber);
        Ok(())
    }
}

/// Copies the detector's status to where the board reads it.
async fn follow(mut from: watch::Receiver<DetectorStatus>, to: watch::Sender<DetectorStatus>) {
    loop {
        let status = from.borrow_and_update().clone();
        to.send_replace(status);
        if from.changed().await.is_err() {
            return;
        }
    }
}
