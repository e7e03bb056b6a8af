//! Why something cannot be done with certificates, rules or a router.

use albireo_service::http::HttpError;
use albireo_wire::KeyError;
use std::fmt::Display;
use std::path::Path;

/// Why something cannot be done with certificates, rules or a router.
#[derive(Debug, thiserror::Error)]
pub enum RouterError {
    /// A name or the prefix cannot be used.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// A certificate cannot be made.
    #[error("the certificate cannot be made: {0}")]
    Certificate(#[from] rcgen::Error),
    /// The HTTP interface may not be offered as configured.
    #[error("[http] {0}")]
    Http(#[from] HttpError),
    /// Another reason, in words.
    #[error("{0}")]
    Other(String),
}

/// A reason in words.
pub(crate) fn other<T>(reason: impl Into<String>) -> Result<T, RouterError> {
    Err(RouterError::Other(reason.into()))
}

/// For what goes wrong with a file.
pub(crate) fn at<E: Display>(file: &Path) -> impl Fn(E) -> RouterError + '_ {
    move |reason| RouterError::Other(format!("{}: {reason}", file.display()))
}
