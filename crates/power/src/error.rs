//! Errors of power meters.

use std::fmt::Display;
use std::path::Path;

/// The reason a meter cannot be used or read.
#[derive(Debug, thiserror::Error)]
pub enum MeterError {
    /// The machine does not have it.
    #[error("{0}")]
    Missing(String),
    /// The machine has it, but it cannot be used or read.
    #[error("{0}")]
    Failed(String),
}

impl MeterError {
    /// The machine does not have the meter.
    pub(crate) fn missing(reason: impl Display) -> Self {
        Self::Missing(format!("not on this machine: {reason}"))
    }

    /// A file, program or device of the meter cannot be read.
    pub(crate) fn unreadable(path: &Path, reason: impl Display) -> Self {
        Self::Failed(format!("cannot read {}: {reason}", path.display()))
    }

    /// This user may not read the meter; `remedy` is the solution to suggest.
    pub(crate) fn forbidden(path: &Path, remedy: impl Display) -> Self {
        let path = path.display();
        Self::Failed(format!("may not read {path}: permission denied; {remedy}"))
    }

    /// Names the meter in front.
    pub(crate) fn of(self, source: &str) -> Self {
        let named = |reason: String| format!("{source}: {reason}");
        match self {
            Self::Missing(reason) => Self::Missing(named(reason)),
            Self::Failed(reason) => Self::Failed(named(reason)),
        }
    }
}
