//! The state of the detector, for readiness, metrics and clip reports.

use super::{ExecutionProvider, InferenceError};

/// The state of a model's worker, published on a watch channel.
#[derive(Clone, Debug, PartialEq)]
pub enum DetectorStatus {
    /// The session is being built and warmed up.
    Starting,
    /// It runs.
    Ready {
        /// What really runs it.
        provider: ExecutionProvider,
    },
    /// It runs, and what it finds is impossible, run after run.
    Implausible {
        /// What is found, in words.
        reason: String,
        /// What really runs it.
        provider: ExecutionProvider,
    },
    /// The last run failed and the session is being rebuilt, or a run takes too long; frames are answered from
    /// prediction meanwhile.
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

impl DetectorStatus {
    /// What is wrong, in words, where anything is.
    pub fn fault(&self) -> Option<&str> {
        match self {
            Self::Starting | Self::Ready { .. } => None,
            Self::Implausible { reason, .. }
            | Self::Degraded { reason, .. }
            | Self::Lost { reason, .. } => Some(reason),
        }
    }

    /// What a picture is refused with now, if it is.
    pub(crate) fn refusal(&self) -> Option<InferenceError> {
        match self {
            Self::Ready { .. } | Self::Implausible { .. } => None,
            Self::Starting => Some(InferenceError::Unavailable("it starts".to_owned())),
            Self::Degraded { reason, .. } | Self::Lost { reason, .. } => {
                Some(InferenceError::Unavailable(reason.clone()))
            }
        }
    }

    /// What runs it, or ran it last.
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
