//! The interfaces of a running node: HTTP and Zenoh keys.

pub mod http;
pub(crate) mod keys;
pub(crate) mod name;
