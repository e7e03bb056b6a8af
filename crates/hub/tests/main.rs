//! Promises of the hub, over real Zenoh sessions and real databases. Each test named `postgres_…` starts its own server.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

mod history;
mod ingest;
mod live;
mod presence;
mod targets;
mod tuning;
