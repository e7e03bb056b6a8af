//! Why a fleet cannot be played.

use std::path::PathBuf;

/// Why a fleet cannot be played.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulateError {
    /// The options are out of bounds.
    #[error("{0}")]
    Options(String),
    /// It was stopped before it began.
    #[error("stopped before all sessions were open")]
    Stopped,
    /// The file with Zenoh's configuration cannot be used.
    #[error("{}: {reason}", file.display())]
    ConfigFile {
        /// The file.
        file: PathBuf,
        /// What Zenoh says.
        reason: String,
    },
    /// A setting that Zenoh does not take.
    #[error("{key}: {reason}")]
    Setting {
        /// Its name.
        key: &'static str,
        /// What Zenoh says.
        reason: String,
    },
    /// A session cannot be opened.
    #[error("session {index}: {reason}")]
    Session {
        /// Which one.
        index: usize,
        /// What Zenoh says.
        reason: String,
    },
    /// A node's name cannot stand in a key.
    #[error("a simulated node's name: {0}")]
    Key(#[from] albireo_wire::KeyError),
    /// Zenoh refuses what a node declares.
    #[error("{what} of {node}: {reason}")]
    Declaration {
        /// What is declared.
        what: &'static str,
        /// The node.
        node: String,
        /// What Zenoh says.
        reason: String,
    },
    /// The task of a session ended before its time.
    #[error("a simulated session failed: {0}")]
    Task(#[from] tokio::task::JoinError),
}
