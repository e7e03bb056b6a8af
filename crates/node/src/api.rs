//! How a running node is asked and told: HTTP and keys of Zenoh.

pub mod http;
pub(crate) mod key_service;
pub mod name;
pub(crate) mod threshold;
