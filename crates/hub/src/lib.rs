//! The hub of a fleet: it stores the nodes' clip reports exactly once, knows which nodes are online, and serves their
//! history from a database over HTTP. [`run()`] is the service.

pub mod config;
pub mod desired;
mod error;
pub mod http;
pub mod ingest;
mod named;
mod per_node;
pub mod presence;
mod run;
pub mod store;
pub mod tuning;

pub use error::HubError;
pub use run::run;
