//! Defines the error of a simulated fleet.

use std::fmt::Display;

/// The reason a fleet cannot be simulated, as text.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SimulateError(pub(crate) String);

impl SimulateError {
    /// Prefixes an error with what it is about.
    pub(crate) fn at<E: Display>(what: impl Display) -> impl FnOnce(E) -> Self {
        move |error| Self(format!("{what}: {error}"))
    }
}
