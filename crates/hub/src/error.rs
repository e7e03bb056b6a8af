//! Errors that keep a hub from starting or end it.

use crate::store::StoreError;
use albireo_service::http::HttpError;
use albireo_service::session::SessionError;
use albireo_service::supervise::TaskFailed;
use albireo_wire::KeyError;

/// Why a hub cannot start, or ended.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HubError {
    /// The prefix cannot stand in a key.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The Zenoh session cannot be opened as configured.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Zenoh refuses one of the hub's declarations.
    #[error("{what}: {reason}")]
    Declaration {
        /// What the hub then cannot do.
        what: &'static str,
        /// What Zenoh says.
        reason: String,
    },
    /// The database cannot be used, and waiting does not help.
    #[error("[database] {url}: {source}")]
    Database {
        /// Which one, without its password.
        url: String,
        /// Why.
        source: StoreError,
    },
    /// The HTTP interface cannot be offered.
    #[error("[http]: {0}")]
    Http(#[from] HttpError),
    /// A task the hub cannot do without has ended by itself.
    #[error(transparent)]
    Task(#[from] TaskFailed),
    /// The operating system refuses something.
    #[error("{what}: {source}")]
    System {
        /// What was tried.
        what: &'static str,
        /// Why it failed.
        source: std::io::Error,
    },
}

impl HubError {
    /// A declaration that Zenoh refuses.
    pub(crate) fn declaration(what: &'static str) -> impl Fn(zenoh::Error) -> Self {
        move |error| Self::Declaration {
            what,
            reason: error.to_string(),
        }
    }

    /// Something the operating system refuses.
    pub(crate) fn system(what: &'static str) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::System { what, source }
    }
}
