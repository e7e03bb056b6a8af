//! Defines the error of a hub.

use std::fmt::Display;

/// The reason that a hub cannot start or that it stopped, as text.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct HubError(String);

impl HubError {
    /// Prefixes an error with the operation that failed.
    pub(crate) fn at<E: Display>(what: &str) -> impl Fn(E) -> Self {
        move |error| Self(format!("{what}: {error}"))
    }

    /// The error of a part, whose text says all.
    pub(crate) fn of(error: impl Display) -> Self {
        Self(error.to_string())
    }
}
