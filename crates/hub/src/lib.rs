//! The hub of a fleet: it takes the nodes' clip reports exactly once, knows which nodes are there and how they are,
//! keeps their history in a database, and shows it by HTTP. [`run()`] is the service.

pub mod config;
pub mod desired;
mod error;
pub mod http;
pub mod ingest;
mod named;
mod per_node;
pub mod presence;
pub mod readiness;
mod run;
pub mod store;
pub mod tuning;

pub use error::HubError;
pub use run::run;
