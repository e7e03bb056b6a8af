//! The hub of a fleet: it takes the nodes' clip reports exactly once, knows which nodes are there and how they are,
//! keeps their history in a database, and shows it by HTTP. [`run()`] is the service.

mod clock;
pub mod config;
pub mod desired;
pub mod events;
pub mod http;
pub mod ingest;
pub mod presence;
pub mod readiness;
mod run;
<<<<<<< HEAD
pub mod tuning;
=======
pub mod store;
>>>>>>> 37abeca (wip)

pub use run::run;
