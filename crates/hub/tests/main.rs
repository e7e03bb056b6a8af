//! Promises of the hub, over real Zenoh sessions and databases. Each test with `postgres` in its name starts a server.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

/// The limit of each test by rstest; cargo has it only in this project's folder.
const _: &str = env!("RSTEST_TIMEOUT");

mod support;

mod history;
mod ingest;
mod live;
mod positions;
mod presence;
mod ready;
mod targets;
mod tuning;
