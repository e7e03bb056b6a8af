//! Free ports for the processes that tests start.

use std::sync::atomic::{AtomicU32, Ordering};

/// A port that is free at this moment.
pub(crate) fn free_port() -> u16 {
    // Each port is given out once, below the range of outgoing connections, so that it stays free until its listener starts.
    static GIVEN: AtomicU32 = AtomicU32::new(0);
    let start = std::process::id().wrapping_mul(250);
    let ports = std::iter::repeat_with(|| {
        let given = GIVEN.fetch_add(1, Ordering::Relaxed);
        10_000 + (start.wrapping_add(given) % 22_000) as u16
    });
    let is_free = |port: &u16| std::net::TcpListener::bind(("127.0.0.1", *port)).is_ok();
    ports
        .take(22_000)
        .find(is_free)
        .expect("the loopback interface has a free port")
}
