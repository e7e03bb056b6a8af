//! Promises of the hub, over real Zenoh sessions and databases. Each test with `postgres` in its name starts a server.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

mod history;
mod ingest;
mod live;
mod presence;
mod targets;
mod tuning;
