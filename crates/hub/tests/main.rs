//! Promises of the hub, over real Zenoh sessions and databases. Each test with `postgres` in its name starts a server.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![expect(
    clippy::too_many_lines,
    clippy::cognitive_complexity,
    reason = "a promise tells one story, from the start of a fleet to its end, and each assertion counts as a branch"
)]

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
