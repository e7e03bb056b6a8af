//! The reasons why a frame that arrived cannot be used.

/// A fault of a frame. Each kind has its own counter.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameFault {
    /// The picture cannot be decoded, or contradicts its own header.
    #[error("undecodable picture: {reason}")]
    Undecodable {
        /// The human-readable reason.
        reason: String,
    },
    /// Payload, picture or decoded size is above its limit.
    #[error("oversized frame: {reason}")]
    Oversized {
        /// The size that is too large, and the limit.
        reason: String,
    },
    /// The payload is of an unknown kind, or the attachment cannot be read.
    #[error("unknown format: {reason}")]
    UnknownFormat {
        /// The format found, and those accepted.
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

    /// A payload of an unknown kind.
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
