//! Errors of starting a session and of running it.

use super::Signature;
use std::fmt::Display;
use std::path::Path;

/// The reason why a model could not be started. Every message names a remedy.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct StartError(pub(crate) String);

impl StartError {
    /// The value of a configuration key contradicts itself or the model.
    pub(crate) fn configuration(key: impl Display, reason: impl Display) -> Self {
        Self(format!("{key}: {reason}"))
    }

    /// The ONNX file is missing, damaged or not supported by this ONNX Runtime.
    pub(crate) fn unreadable(model: &Path, reason: impl Display) -> Self {
        let model = model.display();
        Self(format!("the model {model} cannot be loaded: {reason}"))
    }

    /// The model is sound, but its inputs or outputs are not what `head` expects.
    pub(crate) fn does_not_fit(
        model: &Path,
        signature: &Signature,
        (head, expected): (&str, &str),
        reason: impl Display,
    ) -> Self {
        Self(format!(
            "the model {} does not fit the head `{head}`: {reason}. The model has {signature}; the head expects \
             {expected}. Choose the head that belongs to the model, or export the model as the head expects it",
            model.display()
        ))
    }

    /// The model was loaded, but its first run failed.
    pub(crate) fn first_run(model: &Path, reason: impl Display) -> Self {
        let model = model.display();
        Self(format!(
            "the first run of the model {model} failed: {reason}"
        ))
    }

    /// The thread that builds the session could not be started, or panicked.
    pub(crate) fn thread(task: &str, reason: impl Display) -> Self {
        Self(format!(
            "the thread of the {task} failed while it was starting: {reason}"
        ))
    }
}

/// The reason why a picture was not answered. Its frame can be answered from prediction.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InferenceError {
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
    /// No session can accept pictures now: it is being rebuilt after a failure, or a run takes too long.
    #[error("no session can accept pictures now: {0}")]
    Unavailable(String),
    /// The worker has been stopped.
    #[error("the worker has been stopped")]
    Stopped,
}
