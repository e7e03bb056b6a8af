//! The common parts of albireo's services: configuration, Zenoh session, HTTP server, log, and shutdown.
//! Independent of node and hub.

pub mod archive;
pub mod clock;
pub mod config;
pub mod connection;
pub mod http;
pub mod identity;
pub mod logging;
pub mod metrics;
pub mod notify;
pub mod panics;
pub mod process;
pub mod rate_limit;
pub mod readiness;
pub mod session;
pub mod signals;
pub mod supervise;

/// The reason a part of a service cannot be started.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ServiceError(String);
