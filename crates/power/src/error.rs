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
    /// The machine does not have the meter `source`.
    pub(crate) fn missing(source: &str, reason: impl Display) -> Self {
        Self::Missing(format!("{source}: not on this machine: {reason}"))
    }

    /// A file, program or device of the meter `source` cannot be read.
    pub(crate) fn unreadable(source: &str, path: &Path, reason: impl Display) -> Self {
        Self::Failed(format!(
            "{source}: cannot read {}: {reason}",
            path.display()
        ))
    }

    /// This user may not read the meter `source`; `remedy` is the solution to suggest.
    pub(crate) fn forbidden(source: &str, path: &Path, remedy: impl Display) -> Self {
        let path = path.display();
        Self::Failed(format!(
            "{source}: may not read {path}: permission denied; {remedy}"
        ))
    }
}
