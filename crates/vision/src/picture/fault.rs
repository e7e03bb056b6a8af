//! The reasons why a frame that arrived cannot be used.

/// A fault of a frame. Each kind has its own counter.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameFault {
    /// The picture cannot be decoded, or contradicts its own header.
    #[error("undecodable picture: {0}")]
    Undecodable(String),
    /// Payload, picture or decoded size is above its limit.
    #[error("oversized frame: {0}")]
    Oversized(String),
    /// The payload is of an unknown kind, or the attachment cannot be read.
    #[error("unknown format: {0}")]
    UnknownFormat(String),
}

impl FrameFault {
    /// A picture that cannot be decoded.
    pub fn undecodable(reason: impl Into<String>) -> Self {
        Self::Undecodable(reason.into())
    }

    /// A frame above a limit.
    pub(crate) fn oversized(reason: impl Into<String>) -> Self {
        Self::Oversized(reason.into())
    }

    /// A payload of an unknown kind.
    pub fn unknown_format(reason: impl Into<String>) -> Self {
        Self::UnknownFormat(reason.into())
    }

    /// The counter's name: `undecodable`, `oversized` or `unknown_format`.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Undecodable(_) => "undecodable",
            Self::Oversized(_) => "oversized",
            Self::UnknownFormat(_) => "unknown_format",
        }
    }
}
