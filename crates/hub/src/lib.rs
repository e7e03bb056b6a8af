//! The hub of a fleet: it stores the nodes' clip reports exactly once, knows which nodes are online, and serves their
//! history from a database over HTTP. [`run()`] is the service.

mod answers;
pub mod config;
mod error;
pub mod history;
pub mod http;
mod hub;
pub mod ingest;
mod named;
mod per_node;
pub mod presence;
mod run;
pub mod store;
pub mod tuning;

pub use error::HubError;
pub use run::run;
