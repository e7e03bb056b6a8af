//! The error of a node that cannot start, or had to end.

use std::error::Error;
use std::fmt::Display;

/// A node cannot start, or had to end: it names the part, and what is wrong with it.
#[derive(Debug, thiserror::Error)]
#[error("{part}{source}")]
pub struct NodeError {
    part: String,
    source: Box<dyn Error + Send + Sync>,
}

impl NodeError {
    /// An error that says itself what it is of.
    pub(crate) fn new(source: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        let (part, source) = (String::new(), source.into());
        Self { part, source }
    }

    /// An error of this part.
    pub(crate) fn of<E: Into<Box<dyn Error + Send + Sync>>>(
        part: impl Display,
    ) -> impl FnOnce(E) -> Self {
        move |error| Self {
            part: format!("{part}: "),
            source: error.into(),
        }
    }

    /// What Zenoh refuses.
    pub(crate) fn refused(what: impl Display) -> impl FnOnce(zenoh::Error) -> Self {
        move |error| Self::of(what)(albireo_service::session::plain(&error))
    }
}
