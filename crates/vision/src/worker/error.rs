//! The reasons why a worker did not answer a picture.

/// The reason why a picture was not answered. Its frame can be answered from prediction.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RunError {
    /// The picture cannot be answered; the session is unaffected.
    #[error("the picture cannot be used: {0}")]
    BadPicture(String),
    /// The run took too long; no other run begins until it has come back.
    #[error("the run took longer than {timeout_ms} ms")]
    TimedOut {
        /// The time limit.
        timeout_ms: u64,
    },
    /// The run ended with an error; the session is rebuilt.
    #[error("the run failed: {0}")]
    Failed(String),
    /// The results of this run and of those before it are impossible.
    #[error("{0}")]
    Implausible(String),
    /// The run panicked; the session is rebuilt.
    #[error("the run panicked: {0}")]
    Panicked(String),
    /// No session can accept pictures now: it is being built, or rebuilt after a failure, or a run takes too long.
    #[error("no session can accept pictures now: {0}")]
    Unavailable(String),
    /// The worker has been stopped.
    #[error("the worker has been stopped")]
    Stopped,
}
