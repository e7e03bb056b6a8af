//! Runs the Zenoh router of a fleet, and creates the certificates ([`authority`]) and access rules ([`access`]) that
//! keep strangers out.

pub mod access;
pub mod authority;
mod error;
mod http;
mod probe;
mod run;

pub use error::RouterError;
pub use run::{RouterOptions, run};
