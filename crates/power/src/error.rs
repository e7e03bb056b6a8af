//! Errors of power meters.

use std::path::PathBuf;

/// Why a meter cannot be used, or could not be read.
#[derive(Debug, thiserror::Error)]
pub enum MeterError {
    /// The machine does not have it.
    #[error("{source_name}: not on this machine: {reason}")]
    Missing {
        /// The meter.
        source_name: &'static str,
        /// What was looked for and where.
        reason: String,
    },
    /// It is there, but this user may not read it.
    #[error("{source_name}: may not read {}: permission denied; {remedy}", path.display())]
    Permission {
        /// The meter.
        source_name: &'static str,
        /// The file.
        path: PathBuf,
        /// What to do.
        remedy: String,
    },
    /// Reading failed, or what was read makes no sense.
    #[error("{source_name}: cannot read {}: {reason}", path.display())]
    Unreadable {
        /// The meter.
        source_name: &'static str,
        /// The file or device.
        path: PathBuf,
        /// What the system or the driver said, or what was read instead of a figure.
        reason: String,
    },
    /// The configuration asks for something impossible.
    #[error("power.{key}: {reason}")]
    Configuration {
        /// The key in `[power]`.
        key: String,
        /// What is wrong with it, and what is allowed.
        reason: String,
    },
    /// The meter itself failed.
    #[error("{0}")]
    Failed(String),
}
