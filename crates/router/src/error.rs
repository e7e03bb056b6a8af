//! Defines the errors of certificates, rules and routers.

use albireo_service::ServiceError;
use albireo_wire::KeyError;
use std::fmt::Display;
use std::path::Path;

/// The reason an operation on certificates, rules or a router failed.
#[derive(Debug, thiserror::Error)]
pub enum RouterError {
    /// A name or the prefix is invalid.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// A certificate cannot be created.
    #[error("the certificate cannot be created: {0}")]
    Certificate(#[from] rcgen::Error),
    /// The HTTP interface is not allowed as configured.
    #[error("[http] {0}")]
    Http(#[from] ServiceError),
    /// Another reason, as text.
    #[error("{0}")]
    Other(String),
}

/// Returns an error with a reason as text.
pub(crate) fn other<T>(reason: impl Into<String>) -> Result<T, RouterError> {
    Err(RouterError::Other(reason.into()))
}

/// Returns an error about a file.
pub(crate) fn about(file: &Path, reason: impl Display) -> RouterError {
    RouterError::Other(format!("{}: {reason}", file.display()))
}

/// Converts an error about a file.
pub(crate) fn at<E: Display>(file: &Path) -> impl Fn(E) -> RouterError + '_ {
    move |reason| about(file, reason)
}
