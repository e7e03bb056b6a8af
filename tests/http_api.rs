//! The HTTP interface of a node over real connections: every answer a client can get.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod access;
mod connections;
mod documented;
mod events;
mod exposition;
mod looking;
mod metrics;
pub(crate) mod served;
mod threshold;
