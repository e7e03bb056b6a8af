//! Defines the error of a hub that cannot start or that stopped.

use albireo_service::session::SessionError;
use albireo_service::supervise::TaskFailed;
use albireo_wire::KeyError;

/// The reason that a hub cannot start or that it stopped.
#[derive(Debug, thiserror::Error)]
pub enum HubError {
    /// The prefix cannot be part of a key.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The Zenoh session cannot be opened as configured.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// An essential task ended.
    #[error(transparent)]
    Task(#[from] TaskFailed),
    /// Another error, as text: from the database, the HTTP interface, Zenoh or the operating system.
    #[error("{0}")]
    Other(String),
}

impl HubError {
    /// Prefixes an error with the operation that failed.
    pub(crate) fn at<E: std::fmt::Display>(what: &str) -> impl Fn(E) -> Self {
        move |error| Self::Other(format!("{what}: {error}"))
    }
}
