//! The hub of a fleet: it stores the nodes' clip reports exactly once, knows which nodes are online, and serves their
//! history from a database over HTTP. [`run()`] is the service.

pub mod config;
pub mod desired;
pub mod http;
pub mod ingest;
mod named;
mod per_node;
pub mod presence;
mod run;
pub mod store;
pub mod tuning;

pub use run::run;

use std::fmt::Display;

/// The reason that a hub cannot start or that it stopped, as text.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct HubError(String);

impl HubError {
    /// Prefixes an error with the operation that failed.
    pub(crate) fn at<E: Display>(what: &str) -> impl Fn(E) -> Self {
        move |error| Self(format!("{what}: {error}"))
    }
}
