//! A node before its start: the parts that can be shown and changed without a session or a model.

use crate::api::http::{self, RouterSetup};
use crate::camera::{AnswerTime, PolicyMaker};
use crate::config::{CameraConfig, NodeConfig};
use crate::error::NodeError;
use crate::outbox::Outbox;
use crate::position::Positions;
use crate::recorder::Recorder;
use crate::settings::Settings;
use crate::state::board::{Board, BoardSetup, CameraSetup, NodePolicy};
use crate::state::readiness;
use crate::state::target::NodeTarget;
use albireo_service::config::without_secrets;
use albireo_service::identity::Certificates;
use albireo_service::readiness::{Fault, Readiness};
use albireo_wire::KeyError;
use axum::Router;
use std::sync::Arc;
use tokio_util::sync::CancellationToken;

/// A node before its start: its board can already be shown and reports that the node is not ready.
pub struct PreparedNode {
    pub(crate) board: Arc<Board>,
    pub(crate) settings: Arc<Settings>,
    pub(crate) outbox: Arc<Outbox>,
    pub(super) recorder: Arc<Recorder>,
    pub(super) policies: PolicyMaker,
}

impl PreparedNode {
    /// Opens the state directory of a node with this configuration, and creates its board. What was set at run time
    /// before a restart is in force again, unless its configured value was edited since.
    ///
    /// # Errors
    /// [`NodeError`] if the state directory cannot be used, or a name or the policy is invalid.
    pub fn new(config: &NodeConfig) -> Result<Self, NodeError> {
        let directory = config.node.state_dir.as_deref();
        let outbox = Arc::new(Outbox::open(directory)?);
        if directory.is_none() {
            let lost =
                "no node.state_dir: clip reports wait in memory and are lost when the node stops";
            // Without a hub nobody waits for them.
            if config.uplink.is_set() {
                tracing::warn!("{lost}");
            } else {
                tracing::info!("{lost}");
            }
        }
        let policy = NodePolicy::new(config.policy.clone()).map_err(NodeError::new)?;
        let board = board(config, policy).map_err(NodeError::new)?;
        let settings = Arc::new(Settings::open(&board, directory));
        watch_outbox(&board.readiness, &outbox);
        let cameras = config.cameras.iter().map(|camera| camera.name.clone()).collect();
        let recorder = Recorder::new(&config.record, cameras);
        let watched = Arc::clone(&recorder);
        board.readiness.probe(readiness::RECORDER, "", move || watched.fault());
        Ok(Self {
            board,
            settings,
            outbox,
            recorder,
            policies: Arc::new(|_, config| config.build()),
        })
    }

    /// Uses `policies` instead of the configured ones, for a program with its own policy. They should have the
    /// threshold of the policy in force, whose configuration they get.
    #[must_use]
    pub fn with_policies(mut self, policies: PolicyMaker) -> Self {
        self.policies = policies;
        self
    }

    /// The board, which shows the node.
    pub fn board(&self) -> &Arc<Board> {
        &self.board
    }

    /// The routes of the node's HTTP interface and its page. Event streams end with `shutdown`.
    pub fn router(&self, config: &NodeConfig, shutdown: CancellationToken) -> Router {
        let setup = RouterSetup {
            board: Arc::clone(&self.board),
            settings: Arc::clone(&self.settings),
            outbox: Arc::clone(&self.outbox),
            recorder: Arc::clone(&self.recorder),
            limits: config.frame,
            config: without_secrets(config),
        };
        http::router(setup, shutdown)
    }
}

fn board(config: &NodeConfig, policy: NodePolicy) -> Result<Arc<Board>, KeyError> {
    let path = &config.detector.model;
    let model = path.file_name().unwrap_or(path.as_os_str());
    let cameras = config.cameras.iter().map(|camera| camera_setup(config, camera));
    let setup = BoardSetup {
        node: config.node.name.clone(),
        model: model.to_string_lossy().into_owned(),
        providers: config.detector.providers.clone(),
        cameras: cameras.collect::<Result<_, _>>()?,
        certificates: Certificates::read(config.certificates()),
        positions: Positions::new(&config.position),
        target: NodeTarget::new(&config.target, &policy),
        empty_road: config.screen.empty_road(),
        sightings: config.sightings,
    };
    Ok(Board::new(setup, policy))
}

fn camera_setup(config: &NodeConfig, camera: &CameraConfig) -> Result<CameraSetup, KeyError> {
    Ok(CameraSetup {
        name: camera.name.clone(),
        keys: config.keys()?.camera(&camera.name)?,
        key: config.frame_keys(camera)?.swap_remove(0),
        source: camera.source.as_ref().map(ToString::to_string),
        max_rate: camera.max_rate,
        threshold: camera.threshold,
        answers_at_once: config.answer_time(camera) == AnswerTime::AtOnce,
        audit: config.audit.report(),
    })
}

/// Adds probes for the reports in the state directory.
fn watch_outbox(readiness: &Readiness, outbox: &Arc<Outbox>) {
    let disk = Arc::clone(outbox);
    readiness.probe(readiness::DISK, "", move || {
        disk.counts().failing.map(Fault::degraded)
    });
    let reports = Arc::clone(outbox);
    readiness.probe(readiness::OUTBOX, "", move || reports.counts().fault());
}
