//! Defines the errors of a simulated fleet.

/// The reason a fleet cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// A node's name is not valid in a key.
    #[error("a simulated node's name: {0}")]
    Key(#[from] albireo_wire::KeyError),
    /// The task of a session ended early.
    #[error("a simulated session failed: {0}")]
    Task(#[from] tokio::task::JoinError),
    /// Another reason, as text.
    #[error("{0}")]
    Other(String),
}

impl SimulateError {
    /// Creates an error about `what`.
    pub(crate) fn at(what: impl std::fmt::Display, error: impl std::fmt::Display) -> Self {
        Self::Other(format!("{what}: {error}"))
    }
}
