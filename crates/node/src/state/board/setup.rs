//! The parts that a board is built from.

use super::camera::CameraSetup;
use crate::config::{CameraConfig, NodeConfig};
use crate::delivery::outbox::{Outbox, OutboxError};
use crate::state::target::TargetSetup;
use albireo_core::policy::{PolicyConfigError, Profile};
use albireo_vision::detector::{DetectorStatus, ExecutionProvider};
use albireo_wire::KeyError;
use tokio::sync::watch;

/// What a board is made from.
#[derive(Debug)]
pub struct BoardSetup {
    /// The node's name.
    pub node: String,
    /// The cameras, in the order they are to be listed. Names must differ.
    pub cameras: Vec<CameraSetup>,
    /// Where what must survive is kept.
    pub outbox: Outbox,
    /// Name of the policy.
    pub policy: &'static str,
    /// The target that the node holds by moving its threshold.
    pub target: TargetSetup,
    /// What is known about the detector before it starts.
    pub detector: DetectorFacts,
    /// How the detector is doing.
    pub detector_status: watch::Receiver<DetectorStatus>,
}

impl BoardSetup {
    /// The setup that a configuration describes.
    ///
    /// # Errors
    /// What cannot be used; a configuration that passed its check has nothing of the kind.
    pub(crate) fn from_config(
        config: &NodeConfig,
        detector_status: watch::Receiver<DetectorStatus>,
    ) -> Result<Self, SetupError> {
        let policy = config.policy.build()?;
        let camera = |camera: &CameraConfig| -> Result<CameraSetup, SetupError> {
            Ok(CameraSetup {
                name: camera.name.clone(),
                key: config.frame_key(camera)?,
                source: camera.source.as_ref().map(ToString::to_string),
                knob: policy.knob(),
                threshold: camera.threshold.or_else(|| policy.knob_value()),
                sizeless: config.policy.profile == Profile::Paper,
                longest_pause: policy.longest_pause(),
                audited: config.audit.share > 0.0,
            })
        };
        let model = &config.detector.model;
        let model = model.file_name().unwrap_or(model.as_os_str());
        Ok(Self {
            node: config.node.name.clone(),
            cameras: config
                .cameras
                .iter()
                .map(camera)
                .collect::<Result<_, _>>()?,
            outbox: Outbox::open(&config.outbox, config.node.state_dir.as_deref())?,
            policy: policy.name(),
            target: TargetSetup {
                policy: policy.name(),
                knob: policy.knob(),
                configured: config.target.hold,
                range: (config.target.least, config.target.most),
            },
            detector: DetectorFacts {
                model: model.to_string_lossy().into_owned(),
                requested: config.detector.providers.clone(),
            },
            detector_status,
        })
    }
}

/// Why a configuration describes no board.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The policy cannot be made.
    #[error(transparent)]
    Policy(#[from] PolicyConfigError),
    /// The state directory cannot be used.
    #[error(transparent)]
    Outbox(#[from] OutboxError),
    /// A name cannot stand in a key.
    #[error(transparent)]
    Key(#[from] KeyError),
}

/// What is known about the detector before it starts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DetectorFacts {
    /// File name of the model.
    pub model: String,
    /// Execution providers asked for, in order.
    pub requested: Vec<ExecutionProvider>,
}
