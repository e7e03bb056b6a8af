//! The router of a fleet, and what keeps strangers out of it: an authority that makes certificates ([`authority`]),
//! access control generated from them ([`access`]), and a router that counts whom it turns away ([`run()`]).

pub mod access;
pub mod authority;
mod http;
mod probe;
pub mod refusals;
mod run;

pub use run::{RouterError, RouterOptions, run};
