//! The error of a hub that cannot start, or that ended.

use albireo_service::session::SessionError;
use albireo_service::supervise::TaskFailed;
use albireo_wire::KeyError;

/// Why a hub cannot start, or ended.
#[derive(Debug, thiserror::Error)]
pub enum HubError {
    /// The prefix cannot be part of a key.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The Zenoh session cannot be opened as configured.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A task the hub cannot do without has ended by itself.
    #[error(transparent)]
    Task(#[from] TaskFailed),
    /// Another error, in words: from the database, the HTTP interface, Zenoh or the operating system.
    #[error("{0}")]
    Other(String),
}

impl HubError {
    /// Names the part that an error came from.
    pub(crate) fn at<E: std::fmt::Display>(what: &str) -> impl Fn(E) -> Self {
        move |error| Self::Other(format!("{what}: {error}"))
    }
}
