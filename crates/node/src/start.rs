//! Starts the parts of a node in a fixed order, and stops them in reverse.

mod camera;
mod models;
mod prepared;

pub use prepared::PreparedNode;

use crate::api;
use crate::api::name::NodeName;
use crate::config::NodeConfig;
use crate::delivery::uplink::{Uplink, UplinkSetup};
use crate::error::NodeError;
use crate::forwarding::{Hook, Mqtt, MqttSetup, record_sightings};
use crate::outbox::Outbox;
use crate::recorder::Recorder;
use crate::settings::Settings;
use crate::state::board::{Board, provider};
use crate::state::readiness;
use albireo_power::PowerHandle;
use albireo_service::clock::Now;
use albireo_service::readiness::{Fault, Readiness};
use albireo_service::session;
use albireo_service::supervise::Supervisor;
use camera::{SharedParts, Subscriptions};
use models::Models;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, sleep};
use tokio_util::sync::{CancellationToken, DropGuard};
use zenoh::Session;

/// The interval at which the state of parts that do not report it themselves is read.
const POLL_INTERVAL: Duration = Duration::from_secs(1);

/// The interval at which a failed disk is tried again.
const RETRY_EVERY: Duration = Duration::from_secs(2);

/// Limits of connections to the Zenoh port that are not sessions yet, in Zenoh's own terms: their number, and the milliseconds
/// that each has. With Zenoh's own limits, 100 for ten seconds, silent connections keep cameras out. A process may often have
/// no more than 1024 descriptors, of which HTTP takes up to 256.
const ACCEPTING: [(&str, &str); 2] = [
    ("transport/unicast/accept_pending", "400"),
    ("transport/unicast/accept_timeout", "3000"),
];

/// A running node.
pub struct Node {
    shared: Arc<SharedParts>,
    /// All tasks: they end by themselves once the shutdown token is cancelled.
    tasks: Supervisor,
    /// Stops the power sampler, once the last report is out.
    sampling: DropGuard,
    /// Holds the name until the session is closed.
    _name: NodeName,
    uplink: Uplink,
    subscriptions: Subscriptions,
}

impl PreparedNode {
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
        let Self {
            board,
            settings,
            outbox,
            recorder,
            policies,
        } = self;
        let keys = config.keys().map_err(NodeError::new)?;
        let subscribed = board.readiness.part(readiness::CAMERAS);
        subscribed.not_ready("the cameras are not subscribed to yet");

        // The session comes first: without a router, a node need not load a model.
        let session = open_session(config, &board.readiness).await?;

        let stop = CancellationToken::new();
        let sampling = stop.clone().drop_guard();
        let started = albireo_power::start(&config.power, stop).await;
        let (power, sampler) = started.map_err(NodeError::of("[power]"))?;

        let models = Models::start(&config.detector_here(), &config.screen, &board).await?;

        // Whatever starts from here on is watched, and ends in order if one of them fails.
        let mut tasks = Supervisor::new(
            board.readiness.clone(),
            board.tasks.clone(),
            shutdown.clone(),
        );
        models.watch(&mut tasks, &board);
        tasks.until_shutdown("power sampler", sampler);
        watch_board(&board, &power, &mut tasks);
        if config.position.source.is_receiver() {
            let positions = Arc::clone(&board.positions);
            tasks.until_shutdown("position", crate::position::follow(positions));
        }

        // Each camera has its loop, its reporter, and its source of frames.
        let shared = Arc::new(SharedParts {
            config: config.clone(),
            session: session.clone(),
            board: Arc::clone(&board),
            outbox: Arc::clone(&outbox),
            recorder,
            power: power.clone(),
            pixels: models.pixels(config.frame, config.detector.batch_size),
            models,
            policies,
            give_up: CancellationToken::new(),
            shutdown: shutdown.clone(),
        });
        let subscriptions = shared.add_cameras(&mut tasks).await?;

        let counters =
            api::counters::declare(&session, &board, &settings, power, shutdown.clone()).await?;
        tasks.essential("counters", counters);

        let requests = api::keys::declare(&session, &board, &settings, &keys).await?;
        tasks.until_shutdown("requests", requests);

        let retrying = retry_disk(Arc::clone(&outbox), Arc::clone(&settings));
        tasks.until_shutdown("disk", retrying);

        start_forwarding(config, &board, &shared.recorder, &mut tasks, &shutdown)?;

        let name = hold_name(&session, keys.alive(), &board.readiness, &mut tasks);
        let uplink = Uplink::start(UplinkSetup {
            board: Arc::clone(&board),
            settings,
            outbox,
            delivery: config.outbox.clone(),
            uplink: config.uplink.clone(),
            labels: config.node.labels.clone(),
            limits: config.frame,
            keys,
            local: session_to_hub(config, session),
        });
        tasks.until_shutdown("uplink", uplink.ended.clone());

        subscribed.works();
        Ok(Node {
            shared,
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
        let locators = self.shared.session.info().locators().await;
        locators.iter().map(ToString::to_string).collect()
    }

    /// The machine's power and energy, sampled while the node runs.
    pub fn power(&self) -> PowerHandle {
        self.shared.power.clone()
    }

    /// The execution provider that runs the detector, if known.
    pub fn provider(&self) -> Option<&'static str> {
        provider(&self.shared.models.detector.status().borrow())
    }

    /// Runs until the shutdown token is cancelled or an essential task fails. Then it completes the current frames and
    /// open clips, and closes. That takes at most 5 s, even if something hangs: after a quarter of the time it no
    /// longer waits for the detector, and it logs and abandons tasks that have not ended in time.
    ///
    /// # Errors
    /// [`NodeError`] if a task failed.
    pub async fn stopped(mut self) -> Result<(), NodeError> {
        let ended = self.tasks.watch().await;
        let shared = self.shared;
        // After a failed task, this stops the others.
        shared.shutdown.cancel();
        let start = Instant::now();
        let longest = shared.config.node.stop_timeout;
        // The rest of the time is for HTTP and for threads that are still working.
        let tasks_until = start + longest / 2;
        let until = start + longest * 3 / 4;
        let give_up = shared.give_up.clone();
        tokio::spawn(async move {
            sleep(longest / 4).await;
            give_up.cancel();
        });
        let subscriptions = self.subscriptions;
        // Zenoh's calls may block.
        let undeclared = spawn_blocking(move || drop(subscriptions));
        let ending = async { tokio::join!(undeclared, self.tasks.finish()) };
        if tokio::time::timeout_at(tasks_until, ending).await.is_err() {
            tracing::error!(
                tasks = self.tasks.still_running().join(", "),
                "abandoned tasks that did not end in time"
            );
        }
        // The sampler stops after the tasks: the clips' energy comes from it.
        drop(self.sampling);
        let closed = async {
            self.uplink.stop().await;
            shared.session.close().await
        };
        let closing = async {
            // After the cameras, whose last frames belong to the recordings.
            let recorded = shared.recorder.stop();
            let (closed, (), ()) = tokio::join!(closed, shared.models.stop(), recorded);
            if let Err(error) = closed {
                tracing::warn!(%error, "Zenoh session not closed cleanly");
            }
        };
        if tokio::time::timeout_at(until, closing).await.is_err() {
            tracing::error!(
                "abandoned the detector, the Zenoh session or recordings, which did not end in time"
            );
        }
        tracing::info!(
            seconds = albireo_service::clock::seconds(start.elapsed()),
            "stopped"
        );
        ended.map_err(NodeError::new)
    }
}

/// Watches the cameras, the power meter and the certificates, for the readiness that the board shows.
fn watch_board(board: &Board, power: &PowerHandle, tasks: &mut Supervisor) {
    readiness::check_cameras(board);
    readiness::check_power(board, power);
    let watched = board.readiness.clone().watch(POLL_INTERVAL);
    tasks.until_shutdown("readiness", watched);
    tasks.until_shutdown("certificates", board.certificates.clone().follow());
}

/// Starts what tells others of sightings: hooks and MQTT. Their faults are theirs: the node works without them.
fn start_forwarding(
    config: &NodeConfig,
    board: &Arc<Board>,
    recorder: &Arc<Recorder>,
    tasks: &mut Supervisor,
    shutdown: &CancellationToken,
) -> Result<(), NodeError> {
    // The operating system provides random keys for each `RandomState`.
    let random = RandomState::new();
    let classes = board.reading.get().map(|reading| reading.classes.clone()).unwrap_or_default();
    for (index, hook) in config.hooks.iter().enumerate() {
        for warning in hook.never_found(index, &classes) {
            tracing::warn!("{warning}");
        }
    }
    let setup = MqttSetup {
        config: config.mqtt.clone(),
        board: Arc::clone(board),
        prefix: config.node.prefix.clone(),
        classes,
        page: config.node.labels.get("page").cloned(),
        random: random.hash_one("mqtt"),
    };
    if let Some(mqtt) = Mqtt::new(setup).map_err(NodeError::of("[mqtt]"))? {
        tasks.essential("mqtt", mqtt.run(shutdown.clone()));
    }
    for (index, hook) in config.hooks.iter().enumerate() {
        if !hook.posts() {
            continue;
        }
        let hook = Hook::new(hook.clone(), board, random.hash_one(index))
            .map_err(NodeError::of(format!("hook[{index}]")))?;
        tasks.essential(format!("hook {index}"), hook.run(shutdown.clone()));
    }
    if config.hooks.iter().any(|hook| hook.record) {
        let hooks = config.hooks.clone();
        let recording = record_sightings(hooks, Arc::clone(board), Arc::clone(recorder));
        tasks.until_shutdown("recordings of hooks", recording);
    }
    Ok(())
}

/// The node's session, if the hub is reached through it; `None` if the node has an uplink of its own.
fn session_to_hub(config: &NodeConfig, session: Session) -> Option<Session> {
    if config.uplink.is_set() {
        return None;
    }
    Some(session)
}

/// Announces the node's name for as long as it runs.
fn hold_name(
    session: &Session,
    alive: String,
    parts: &Readiness,
    tasks: &mut Supervisor,
) -> NodeName {
    let name = NodeName::default();
    let twin = parts.part_of(readiness::ZENOH, "name");
    let holding = name.clone().hold(session.clone(), alive, twin);
    tasks.until_shutdown("name", holding);
    name
}

/// Opens the node's session, and tells what keeps it from being open.
async fn open_session(config: &NodeConfig, parts: &Readiness) -> Result<Session, NodeError> {
    let zenoh = parts.part(readiness::ZENOH);
    zenoh.not_ready("the session is not open yet");
    // The file of Zenoh has its own settings.
    let settings = match config.zenoh.config_file {
        None => &ACCEPTING[..],
        Some(_) => &[],
    };
    let largest_frame = config.frame.max_payload_bytes;
    // A client waits for its router in any case; otherwise an endpoint that cannot be used is an error.
    let is_patient = false;
    let opening = session::open(
        &config.zenoh,
        largest_frame,
        settings,
        is_patient,
        |error| {
            zenoh.not_ready(format!("the router cannot be reached: {error}"));
        },
    );
    let session = opening.await.map_err(NodeError::new)?;
    zenoh.works();
    let probed = session.clone();
    parts.probe(readiness::ZENOH, readiness::ZENOH_SESSION, move || {
        probed.is_closed().then(|| Fault::not_ready("it is closed"))
    });
    Ok(session)
}

/// Retries a failed disk, for reports and settings, for as long as it is polled.
async fn retry_disk(outbox: Arc<Outbox>, settings: Arc<Settings>) {
    loop {
        sleep(RETRY_EVERY).await;
        let outbox = Arc::clone(&outbox);
        let settings = Arc::clone(&settings);
        let tried = spawn_blocking(move || {
            outbox.change(|waiting| waiting.retry_disk(Now::system()));
            // The failure was logged when the setting was made.
            let _ = settings.save();
        });
        let _ = tried.await;
    }
}
