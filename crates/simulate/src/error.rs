//! Why a fleet cannot be played.

/// Why a fleet cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// A node's name cannot be part of a key.
    #[error("a simulated node's name: {0}")]
    Key(#[from] albireo_wire::KeyError),
    /// The task of a session ended before its time.
    #[error("a simulated session failed: {0}")]
    Task(#[from] tokio::task::JoinError),
    /// Another reason, in words.
    #[error("{0}")]
    Other(String),
}

impl SimulateError {
    /// For what goes wrong with something.
    pub(crate) fn at(what: impl std::fmt::Display, error: impl std::fmt::Display) -> Self {
        Self::Other(format!("{what}: {error}"))
    }
}
