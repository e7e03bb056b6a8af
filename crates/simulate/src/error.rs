//! Errors of playing a fleet.

/// Why a fleet cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// The options are out of bounds.
    #[error("{0}")]
    Options(String),
    /// It was stopped before it began.
    #[error("stopped before all sessions were open")]
    Stopped,
    /// Zenoh refuses something.
    #[error("{what}: {reason}")]
    Zenoh {
        /// A file, a setting, a session or a declaration.
        what: String,
        /// What Zenoh says.
        reason: String,
    },
    /// A node's name cannot be part of a key.
    #[error("a simulated node's name: {0}")]
    Key(#[from] albireo_wire::KeyError),
    /// The task of a session ended before its time.
    #[error("a simulated session failed: {0}")]
    Task(#[from] tokio::task::JoinError),
}

impl SimulateError {
    pub(crate) fn zenoh(what: impl Into<String>, reason: impl ToString) -> Self {
        Self::Zenoh {
            what: what.into(),
            reason: reason.to_string(),
        }
    }
}
