//! The interfaces of a running node: HTTP and Zenoh keys.

pub mod http;
pub(crate) mod key_service;
pub mod name;
pub(crate) mod threshold;
