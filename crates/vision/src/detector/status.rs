//! How the detector is doing: what readiness, metrics and clip reports tell.

use super::ExecutionProvider;

/// The state of the detector task, published on a watch channel.
#[derive(Clone, Debug, PartialEq)]
pub enum DetectorStatus {
    /// The session is being built and warmed up.
    Starting,
    /// It runs.
    Ready {
        /// What really runs it.
        provider: ExecutionProvider,
    },
    /// The last run failed; frames are answered from prediction while the session is rebuilt.
    Degraded {
        /// What happened, in words.
        reason: String,
        /// What ran it before.
        provider: ExecutionProvider,
    },
    /// What ran it is gone, and a new session in this process did not bring it back: what a new start of the program can
    /// repair. It is still tried.
    Lost {
        /// What happened, in words.
        reason: String,
        /// What ran it before.
        provider: ExecutionProvider,
    },
}
