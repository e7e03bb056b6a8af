//! The interfaces of a running node: HTTP and Zenoh keys.

pub(crate) mod counters;
pub mod http;
pub(crate) mod keys;
pub(crate) mod name;
