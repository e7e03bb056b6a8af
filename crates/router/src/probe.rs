//! Opens a session to the router at intervals, as a node would. A running router may have stopped accepting sessions
//! (zenoh#2735); only an attempt shows it.

use albireo_service::session;
use parking_lot::Mutex;
use serde_json::json;
use std::sync::Arc;
use std::time::{Duration, Instant};
use zenoh::{Config, Wait};

/// The time limit of an attempt.
const LIMIT: Duration = Duration::from_secs(20);

/// Consecutive failures before the router counts as stuck. A single attempt may fail while many nodes join.
const STUCK_AFTER: u32 = 3;

/// What the attempts showed.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    /// Failed attempts since the last one that succeeded.
    in_a_row: u32,
    /// Failed attempts since the start.
    pub(crate) failed: u64,
    /// The duration of the last attempt; `None` if it failed, or before the first.
    pub(crate) took: Option<Duration>,
    error: String,
}

impl Seen {
    /// The reason to assume that the router no longer accepts sessions, if any.
    pub(crate) fn stuck(&self) -> Option<String> {
        if self.in_a_row < STUCK_AFTER {
            return None;
        }
        Some(format!(
            "{} attempts in a row opened no session: {}",
            self.in_a_row, self.error
        ))
    }
}

/// The results of the attempts.
#[derive(Clone, Debug, Default)]
pub(crate) struct Probes(Arc<Mutex<Seen>>);

impl Probes {
    /// The results until now.
    pub(crate) fn seen(&self) -> Seen {
        self.0.lock().clone()
    }

    fn record(&self, outcome: Result<Duration, String>) {
        let mut state = self.0.lock();
        match outcome {
            Ok(took) => {
                state.in_a_row = 0;
                state.took = Some(took);
            }
            Err(error) => {
                tracing::warn!(%error, "the router accepted no session");
                state.in_a_row = state.in_a_row.saturating_add(1);
                state.failed += 1;
                state.took = None;
                state.error = error;
            }
        }
    }

    /// Opens a session to `router` every `period`, for as long as it is polled.
    pub(crate) async fn run(&self, router: &Config, endpoint: &str, period: Duration) {
        let client = match client(router, endpoint) {
            Ok(client) => client,
            Err(error) => {
                tracing::warn!(error, "the router cannot be probed");
                return;
            }
        };
        let mut ticks = tokio::time::interval(period);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            let outcome = match tokio::time::timeout(LIMIT, attempt(client.clone())).await {
                Ok(outcome) => outcome,
                Err(_) => Err(format!("none opened within {LIMIT:?}")),
            };
            self.record(outcome);
        }
    }
}

/// Opens a session and closes it again, on a thread that may wait. Returns how long the opening took.
async fn attempt(client: Config) -> Result<Duration, String> {
    let begun = Instant::now();
    let opening = tokio::task::spawn_blocking(move || {
        let session = zenoh::open(client).wait()?;
        let took = begun.elapsed();
        session.close().wait()?;
        Ok::<_, zenoh::Error>(took)
    });
    match opening.await {
        Ok(opened) => opened.map_err(|error| session::plain(&error)),
        Err(error) => Err(error.to_string()),
    }
}

/// The configuration of a client of `router`, with the router's own certificate.
fn client(router: &Config, endpoint: &str) -> Result<Config, String> {
    let own = |key: &str| -> serde_json::Value {
        match router.get_json(&format!("transport/link/tls/{key}")) {
            Ok(text) => serde_json::from_str(&text).unwrap_or_default(),
            Err(_) => json!(null),
        }
    };
    let tls = json!({
        "root_ca_certificate": own("root_ca_certificate"),
        "connect_certificate": own("listen_certificate"),
        "connect_private_key": own("listen_private_key"),
        "enable_mtls": own("enable_mtls"),
        // The address of the router need not be in its certificate.
        "verify_name_on_connect": false,
    });
    let settings = [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("connect/timeout_ms", json!(10_000)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/link/tls", tls),
    ];
    let mut client = Config::default();
    session::set(&mut client, &settings)?;
    Ok(client)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_failures_in_a_row_count_as_stuck_but_two_do_not() {
        let probes = Probes::default();
        for _ in 0..2 {
            probes.record(Err("none".to_owned()));
        }
        assert_eq!(probes.seen().stuck(), None);
        probes.record(Ok(Duration::from_millis(3)));
        for _ in 0..3 {
            probes.record(Err("none".to_owned()));
        }
        let seen = probes.seen();
        let stuck = seen.stuck().unwrap();
        let expected = "3 attempts in a row opened no session: none";
        assert!(stuck.contains(expected), "{stuck}");
        assert_eq!(seen.failed, 5);
        assert_eq!(seen.took, None);
    }
}
