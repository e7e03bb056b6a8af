//! Opens and closes the Zenoh session of a command that sends frames to a node.

use albireo_service::session;
use anyhow::anyhow;
use serde_json::json;
use std::time::Duration;
use zenoh::Config;
use zenoh::session::Session;

/// The endpoint on which a node listens by default.
pub(super) const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// The time that a put may wait for room before Zenoh closes the connection, microseconds. Zenoh's default of 5 s is
/// too short for a receiver that slows its sender down.
const BLOCKED_MICROSECONDS: u64 = 120_000_000;
const BLOCKED: &str = "transport/link/tx/queue/congestion_control/block/wait_before_close";

/// Opens a session that connects only to the given endpoints: as a client of `connect` (of `tcp/127.0.0.1:7447` if both
/// are empty), or as a peer if there is an endpoint to listen on. Tries to connect for `patience`; drop the future to
/// give up.
///
/// # Errors
/// When an endpoint is malformed, or cannot be reached or listened on.
pub async fn open_session(
    connect: &[String],
    listen: &[String],
    patience: Duration,
) -> anyhow::Result<Session> {
    let connect = if connect.is_empty() && listen.is_empty() {
        vec![DEFAULT_ENDPOINT.to_owned()]
    } else {
        connect.to_vec()
    };
    let mode = if listen.is_empty() { "client" } else { "peer" };
    let mut config = Config::default();
    let patience_ms = u64::try_from(patience.as_millis()).unwrap_or(u64::MAX);
    let settings = [
        ("mode", json!(mode)),
        ("connect/endpoints", json!(connect)),
        ("listen/endpoints", json!(listen)),
        ("connect/timeout_ms", json!(patience_ms)),
        ("connect/exit_on_failure", json!(true)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/shared_memory/enabled", json!(false)),
        (BLOCKED, json!(BLOCKED_MICROSECONDS)),
    ];
    session::set(&mut config, &settings)
        .map_err(|error| anyhow!("Zenoh does not accept {error}"))?;
    session::attempt(config)
        .await
        .map_err(|error| no_session(&error, &connect, listen))
}

/// Says why there is no session, after Zenoh's `error`, and what to do.
fn no_session(error: &str, connect: &[String], listen: &[String]) -> anyhow::Error {
    if let Some(said) = session::not_listening("--listen", error) {
        return anyhow!(said);
    }
    let reason = if error.starts_with("Unable to connect to any of") {
        // It repeats the endpoints, and has no reason.
        String::new()
    } else {
        format!(": {error}")
    };
    let endpoints = [connect, listen].concat().join(", ");
    anyhow!(
        "no Zenoh session with {endpoints}{reason}; is the node running, and does it listen there?"
    )
}

/// Closes a session.
///
/// # Errors
/// When Zenoh cannot close it.
pub(crate) async fn close(session: Session) -> anyhow::Result<()> {
    session
        .close()
        .await
        .map_err(|error| anyhow!("closing the Zenoh session: {error}"))
}
