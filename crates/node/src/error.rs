//! The error of a node that cannot start or had to stop.

use std::fmt::Display;

/// A node cannot start or had to stop: names the part and its error.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct NodeError(String);

impl NodeError {
    /// Creates an error that already names its part.
    pub(crate) fn new(error: impl Display) -> Self {
        Self(error.to_string())
    }

    /// Creates an error of this part.
    pub(crate) fn of<E: Display>(part: impl Display) -> impl FnOnce(E) -> Self {
        move |error| Self(format!("{part}: {error}"))
    }

    /// Creates an error for an operation that Zenoh rejected.
    pub(crate) fn refused(what: impl Display) -> impl FnOnce(zenoh::Error) -> Self {
        move |error| Self::of(what)(albireo_service::session::plain(&error))
    }
}
