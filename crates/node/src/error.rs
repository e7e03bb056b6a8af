//! Errors that keep a node from starting or end it.

use crate::delivery::outbox::OutboxError;
use crate::input::source::SourceError;
use albireo_core::policy::PolicyConfigError;
use albireo_power::MeterError;
use albireo_service::http::HttpError;
use albireo_service::supervise::TaskFailed;
use albireo_vision::detector::StartError;
use albireo_wire::KeyError;

/// Why a node cannot start, or had to end.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// The state directory cannot be used.
    #[error(transparent)]
    Outbox(#[from] OutboxError),
    /// A name cannot stand in a key.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The policy cannot be made.
    #[error(transparent)]
    Policy(#[from] PolicyConfigError),
    /// Zenoh refuses something.
    #[error("{0}")]
    Zenoh(String),
    /// The power meter cannot be used.
    #[error("[power]: {0}")]
    Power(#[from] MeterError),
    /// The detector cannot be started.
    #[error("[detector]: {0}")]
    Detector(#[source] StartError),
    /// The empty-scene screen cannot be started.
    #[error("[screen]: {0}")]
    Screen(#[source] StartError),
    /// The state directory cannot be used.
    #[error("[node]: {0}")]
    State(String),
    /// A camera cannot be served.
    #[error("camera `{camera}`: {error}")]
    Camera {
        /// Its name.
        camera: String,
        /// Why.
        #[source]
        error: Box<NodeError>,
    },
    /// A camera's source cannot be opened.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The HTTP interface cannot be offered.
    #[error("[http]: {0}")]
    Http(#[from] HttpError),
    /// A task the node cannot do without has failed.
    #[error(transparent)]
    Task(#[from] TaskFailed),
    /// The operating system refuses something.
    #[error("{what}: {source}")]
    System {
        /// What was tried.
        what: &'static str,
        /// Why it failed.
        source: std::io::Error,
    },
}
