//! Why a frame that did arrive cannot be used.

/// What was wrong with a frame. Each kind has its own counter.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameFault {
    /// The picture cannot be decoded, or contradicts its own header.
    #[error("undecodable picture: {reason}")]
    Undecodable {
        /// What was wrong, for people.
        reason: String,
    },
    /// Payload, picture or decoded size is above its limit.
    #[error("oversized frame: {reason}")]
    Oversized {
        /// What was too large, and the limit.
        reason: String,
    },
    /// The payload is of a kind not known here, or the attachment cannot be read.
    #[error("unknown format: {reason}")]
    UnknownFormat {
        /// What was found and what would do.
        reason: String,
    },
}

impl FrameFault {
    /// A picture that cannot be decoded.
    pub fn undecodable(reason: impl Into<String>) -> Self {
        Self::Undecodable {
            reason: reason.into(),
        }
    }

    /// A frame above a limit.
    pub(crate) fn oversized(reason: impl Into<String>) -> Self {
        Self::Oversized {
            reason: reason.into(),
        }
    }

    /// A payload of no known kind.
    pub fn unknown_format(reason: impl Into<String>) -> Self {
        Self::UnknownFormat {
            reason: reason.into(),
        }
    }

    /// The counter's name: `undecodable`, `oversized` or `unknown_format`.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Undecodable { .. } => "undecodable",
            Self::Oversized { .. } => "oversized",
            Self::UnknownFormat { .. } => "unknown_format",
        }
    }
}
