//! Starts the parts of a node in a fixed order, and stops them in reverse.

mod camera;

use crate::api;
use crate::api::name::NodeName;
use crate::config::NodeConfig;
use crate::delivery::uplink::{Uplink, UplinkSetup};
use crate::error::NodeError;
use crate::state::board::{Board, ModelReading, provider};
use crate::state::readiness;
use albireo_core::policy::{Policy, PolicyConfigError};
use albireo_service::clock::Now;
use albireo_service::readiness::Fault;
use albireo_service::session;
use albireo_service::supervise::Supervisor;
use albireo_vision::detector::{CameraSlot, DetectorHandle, ModelStatus};
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::ScreenHandle;
use camera::{Cameras, Subscriptions};
use futures_util::future::OptionFuture;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, sleep};
use tokio_util::sync::{CancellationToken, DropGuard};

/// The interval at which the state of parts that do not report it themselves is read.
const POLL_INTERVAL: Duration = Duration::from_secs(1);

/// The interval at which a failed disk is tried again.
const RETRY_EVERY: Duration = Duration::from_secs(2);

/// Creates a camera's policy, at its start and whenever its loop has failed: `|camera| policy`.
pub type PolicyMaker =
    Arc<dyn Fn(&str) -> Result<Box<dyn Policy>, PolicyConfigError> + Send + Sync>;

/// A running node.
pub struct Node {
    cameras: Arc<Cameras>,
    /// All tasks: they end by themselves once the shutdown token is cancelled.
    tasks: Supervisor,
    /// Stops the power sampler, once the last report is out.
    sampling: DropGuard,
    /// Holds the name until the session is closed.
    _name: NodeName,
    uplink: Uplink,
    subscriptions: Subscriptions,
}

/// A node before its start: its board can already be shown and reports that the node is not ready.
pub struct PreparedNode {
    board: Arc<Board>,
    policies: PolicyMaker,
}

impl PreparedNode {
    /// Creates the board of a node with this configuration.
    ///
    /// # Errors
    /// [`NodeError`] if a name or the policy is invalid.
    pub fn new(config: &NodeConfig) -> Result<Self, NodeError> {
        let board = Board::open(config)?;
        let cameras = board.readiness.part(readiness::CAMERAS);
        cameras.not_ready("the cameras are not subscribed to yet");
        let policy = config.policy.clone();
        Ok(Self {
            board,
            policies: Arc::new(move |_| policy.build()),
        })
    }

    /// Uses `policies` instead of the configured ones, for a program with its own policy. They should have the
    /// configured policy's threshold.
    #[must_use]
    pub fn with_policies(mut self, policies: PolicyMaker) -> Self {
        self.policies = policies;
        self
    }

    /// The board, which shows the node.
    pub fn board(&self) -> &Arc<Board> {
        &self.board
    }

    /// Starts the node and returns once its cameras' frames can be received. It runs until `shutdown` is cancelled;
    /// then call [`Node::stopped`]. Loading a model may take minutes, or hang: drop the future to give up.
    ///
    /// # Errors
    /// [`NodeError`] if a part cannot start: the message names the part and the remedy.
    pub async fn start(
        self,
        config: &NodeConfig,
        shutdown: CancellationToken,
    ) -> Result<Node, NodeError> {
        let Self { board, policies } = self;
        let keys = config.keys().map_err(NodeError::new)?;
        let zenoh = board.readiness.part(readiness::ZENOH);
        zenoh.not_ready("the session is not open yet");
        let limit = config.frame.max_payload_bytes;
        let session = session::open(&config.zenoh, limit, &[], false, |error| {
            zenoh.not_ready(format!("the router cannot be reached: {error}"));
        })
        .await
        .map_err(NodeError::new)?;
        zenoh.works();
        let probed = session.clone();
        (board.readiness).probe(readiness::ZENOH, readiness::ZENOH_SESSION, move || {
            probed.is_closed().then(|| Fault::not_ready("it is closed"))
        });
        let stop = CancellationToken::new();
        let sampling = stop.clone().drop_guard();
        let (power, sampler) =
            (albireo_power::start(&config.power, stop).await).map_err(NodeError::of("[power]"))?;
        tracing::info!(model = %config.detector.model.display(), "loading the detector");
        let detector = DetectorHandle::start(&config.detector)
            .await
            .map_err(NodeError::of("[detector]"))?;
        let left_out = detector.left_out();
        tracing::info!(
            reads = detector.description(),
            provider = detector.provider().as_str(),
            reports = detector.class_names().join(", "),
            not_reported = left_out.len(),
            "the detector is ready{}",
            match left_out {
                [] => "",
                _ => "; detector.report_classes = [] reports all classes of the model",
            }
        );
        let _ = board.reading.set(ModelReading {
            description: detector.description().to_owned(),
            classes: detector.class_names().to_vec(),
            left_out: left_out.to_vec(),
            meter: detector.head_meter(),
        });
        let screen = ScreenHandle::start(&config.screen, config.detector.onnxruntime.as_deref())
            .await
            .map_err(NodeError::of("[screen]"))?;

        if let Some(screen) = &screen {
            let status = screen.status();
            (board.readiness).probe(readiness::SCREEN, "", move || {
                readiness::of_screen(&status.borrow())
            });
        }
        let screen_meter = screen.as_ref().map(ScreenHandle::meter);
        let _ = board.meters.set((detector.meter(), screen_meter));
        let mut tasks = Supervisor::new(
            board.readiness.clone(),
            board.tasks.clone(),
            shutdown.clone(),
        );
        tasks.until_shutdown(
            "detector status",
            follow(detector.status(), Arc::clone(&board)),
        );
        let worker = detector.clone();
        tasks.until_shutdown("detector", async move { worker.ended().await });
        if let Some(worker) = screen.clone() {
            tasks.until_shutdown("screen", async move { worker.ended().await });
        }
        readiness::look_at_cameras(&board);
        readiness::look_at_power(&board, &power);
        let watched = board.readiness.clone();
        tasks.until_shutdown("readiness", async move {
            watched.watch(POLL_INTERVAL).await;
        });
        tasks.until_shutdown("power sampler", sampler);
        let cameras = Arc::new(Cameras {
            config: config.clone(),
            session,
            board: Arc::clone(&board),
            power: power.clone(),
            pixels: PixelWork::new(
                detector.preparation().clone(),
                screen.as_ref().map(ScreenHandle::input_format),
                config.frame,
                config.detector.batch_size,
            ),
            detector,
            screen,
            policies,
            give_up: CancellationToken::new(),
            shutdown: shutdown.clone(),
        });
        let session = &cameras.session;
        let mut subscriptions = Subscriptions::new();
        for (slot, (camera, board)) in config.cameras.iter().zip(&board.cameras).enumerate() {
            let slot = CameraSlot(slot);
            let adding = cameras.add(slot, camera, board, &mut tasks, &mut subscriptions);
            let named = NodeError::of(format!("camera `{}`", camera.name));
            adding.await.map_err(named)?;
        }
        let outlets = api::counters::declare(session, &board).await?;
        let counting = api::counters::run(Arc::clone(&board), power, outlets, shutdown.clone());
        tasks.essential("counters", counting);
        let requests = api::keys::declare(session, &board, keys.target()).await?;
        tasks.until_shutdown("requests", requests);
        tasks.until_shutdown("disk", retry_disk(Arc::clone(&board)));
        let name = NodeName::default();
        let holding = name.clone().hold(
            session.clone(),
            keys.alive(),
            board.readiness.part_of(readiness::ZENOH, "name"),
        );
        tasks.until_shutdown("name", holding);
        let uplink = Uplink::start(UplinkSetup {
            board: Arc::clone(&board),
            config: config.clone(),
            keys,
            local: (!config.uplink.is_set()).then(|| session.clone()),
        });
        tasks.until_shutdown("uplink", uplink.ended.clone());
        board.readiness.part(readiness::CAMERAS).works();
        Ok(Node {
            cameras,
            tasks,
            sampling,
            _name: name,
            uplink,
            subscriptions,
        })
    }
}

impl Node {
    /// The addresses on which the node's Zenoh session listens, with the actual ports of endpoints configured with port
    /// 0.
    pub async fn endpoints(&self) -> Vec<String> {
        let locators = self.cameras.session.info().locators().await;
        locators.iter().map(ToString::to_string).collect()
    }

    /// The execution provider that runs the detector, if known.
    pub fn provider(&self) -> Option<&'static str> {
        provider(&self.cameras.detector.status().borrow())
    }

    /// Runs until the shutdown token is cancelled or an essential task fails. Then it completes the current frames and
    /// open clips, and closes. That takes at most 5 s, even if something hangs: after a quarter of the time it no
    /// longer waits for the detector, and it logs and abandons tasks that have not ended in time.
    ///
    /// # Errors
    /// [`NodeError`] if a task failed.
    pub async fn stopped(mut self) -> Result<(), NodeError> {
        let ended = self.tasks.watch().await;
        let cameras = self.cameras;
        // After a failed task, this stops the others.
        cameras.shutdown.cancel();
        let (start, longest) = (Instant::now(), cameras.config.node.stop_timeout);
        // The rest of the time is for HTTP and for threads that are still working.
        let tasks_until = start + longest / 2;
        let until = start + longest * 3 / 4;
        let give_up = cameras.give_up.clone();
        tokio::spawn(async move {
            sleep(longest / 4).await;
            give_up.cancel();
        });
        let subscriptions = self.subscriptions;
        // Zenoh's calls may block.
        let undeclared = spawn_blocking(move || drop(subscriptions));
        let ending = async { tokio::join!(undeclared, self.tasks.finish()) };
        if (tokio::time::timeout_at(tasks_until, ending).await).is_err() {
            tracing::error!(
                tasks = ?self.tasks.still_running(),
                "abandoned tasks that did not end in time"
            );
        }
        // The sampler stops after the tasks: the clips' energy comes from it.
        drop(self.sampling);
        let closed = async {
            self.uplink.stop().await;
            cameras.session.close().await
        };
        let closing = async {
            let screen = OptionFuture::from(cameras.screen.as_ref().map(ScreenHandle::stop));
            let (closed, (), _) = tokio::join!(closed, cameras.detector.stop(), screen);
            if let Err(error) = closed {
                tracing::warn!(%error, "Zenoh session not closed cleanly");
            }
        };
        if tokio::time::timeout_at(until, closing).await.is_err() {
            tracing::error!(
                "abandoned the detector or the Zenoh session, which did not end in time"
            );
        }
        tracing::info!(
            seconds = albireo_service::clock::seconds(start.elapsed()),
            "stopped"
        );
        ended.map_err(NodeError::new)
    }
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

/// Retries a failed disk, for reports and settings, for as long as it is polled.
async fn retry_disk(board: Arc<Board>) {
    loop {
        sleep(RETRY_EVERY).await;
        let board = Arc::clone(&board);
        let tried = spawn_blocking(move || {
            board.outbox.change(|waiting| waiting.retry_disk(Now::system()));
            // The failure was logged when the setting was made.
            let _ = board.settings.save();
        });
        let _ = tried.await;
    }
}
