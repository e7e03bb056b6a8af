//! The error of a node that cannot start or had to stop.

use std::error::Error;
use std::fmt::Display;

/// A node cannot start or had to stop: names the part and its error.
#[derive(Debug, thiserror::Error)]
#[error("{part}{source}")]
pub struct NodeError {
    part: String,
    source: Box<dyn Error + Send + Sync>,
}

impl NodeError {
    /// Creates an error that already names its part.
    pub(crate) fn new(source: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        let (part, source) = (String::new(), source.into());
        Self { part, source }
    }

    /// Creates an error of this part.
    pub(crate) fn of<E: Into<Box<dyn Error + Send + Sync>>>(
        part: impl Display,
    ) -> impl FnOnce(E) -> Self {
        move |error| Self {
            part: format!("{part}: "),
            source: error.into(),
        }
    }

    /// Creates an error for an operation that Zenoh rejected.
    pub(crate) fn refused(what: impl Display) -> impl FnOnce(zenoh::Error) -> Self {
        move |error| Self::of(what)(albireo_service::session::plain(&error))
    }
}
