//! The Zenoh settings of a hub, in addition to the configured ones.

/// Most sessions of a hub that is its nodes' router.
pub(crate) const MAX_SESSIONS: u64 = 12_000;

/// The settings. The lease is long because many joining nodes can keep a router busy for 30 s: a session that is lost
/// then declares everything again, which keeps the router busy for longer. The limits leave room for nodes that connect to
/// the hub itself: by default Zenoh silently refuses sessions beyond 1,000.
pub(crate) const SESSION: &[(&str, &str)] = &[
    ("transport/link/tx/lease", "60000"),
    // As many as `MAX_SESSIONS`.
    ("transport/unicast/max_sessions", "12000"),
    ("transport/unicast/accept_pending", "2000"),
    // There are few hubs, so they may reconnect immediately.
    (
        "connect/retry",
        r#"{"period_init_ms":250,"period_max_ms":2000,"period_increase_factor":2}"#,
    ),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_metric_of_the_limit_is_the_limit() {
        let limit = MAX_SESSIONS.to_string();
        assert!(SESSION.contains(&("transport/unicast/max_sessions", &*limit)));
    }
}
