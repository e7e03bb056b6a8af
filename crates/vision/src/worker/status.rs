//! The state of a model's worker, for readiness, metrics and clip reports.

use super::RunError;
use crate::onnx::ExecutionProvider;

/// The state of a model's worker, published on a watch channel.
#[derive(Clone, Debug, PartialEq)]
pub enum ModelStatus {
    /// The session is being built and warmed up.
    Starting,
    /// The model runs.
    Ready {
        /// The provider that actually runs it.
        provider: ExecutionProvider,
    },
    /// The model runs, but its results are impossible, run after run.
    Implausible {
        /// The fault.
        reason: String,
        /// The provider that actually runs it.
        provider: ExecutionProvider,
    },
    /// The last run failed and the session is being rebuilt, or a run takes too long; frames are answered from
    /// prediction until then.
    Degraded {
        /// The failure.
        reason: String,
        /// The provider that ran it before.
        provider: ExecutionProvider,
    },
    /// The GPU is gone, and a new session in this process did not bring it back; restarting the program can.
    /// Rebuilding is still tried.
    Lost {
        /// The failure.
        reason: String,
        /// The provider that ran it before.
        provider: ExecutionProvider,
    },
}

impl ModelStatus {
    /// The fault, if there is one.
    pub fn fault(&self) -> Option<&str> {
        match self {
            Self::Starting | Self::Ready { .. } => None,
            Self::Implausible { reason, .. }
            | Self::Degraded { reason, .. }
            | Self::Lost { reason, .. } => Some(reason),
        }
    }

    /// The error with which a picture is refused now, if it is.
    pub(crate) fn refusal(&self) -> Option<RunError> {
        match self {
            Self::Ready { .. } | Self::Implausible { .. } => None,
            Self::Starting => Some(RunError::Unavailable("it is starting".to_owned())),
            Self::Degraded { reason, .. } | Self::Lost { reason, .. } => {
                Some(RunError::Unavailable(reason.clone()))
            }
        }
    }

    /// The provider that runs the model, or ran it last.
    pub const fn provider(&self) -> Option<ExecutionProvider> {
        match self {
            Self::Starting => None,
            Self::Ready { provider }
            | Self::Implausible { provider, .. }
            | Self::Degraded { provider, .. }
            | Self::Lost { provider, .. } => Some(*provider),
        }
    }
}
