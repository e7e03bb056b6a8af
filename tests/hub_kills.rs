//! The hub as a process, killed during ingest: every report is one row in its database.

use crate::support::fleet::{
    HubProcess, Reply, from_environment, now_ns, on_both, send, settings, uplink,
};
use crate::support::{PATIENCE, until};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

const NODES: usize = 4;

/// A node that makes reports and sends them until they are acknowledged. Returns the number of reports.
async fn node(
    index: usize,
    zenoh: String,
    stop: Arc<AtomicBool>,
    acknowledged: Arc<AtomicU64>,
) -> u64 {
    let name = format!("car-{index}");
    let session = uplink(&zenoh).await;
    let begun = now_ns();
    let (mut made, mut stored) = (0_u64, 0_u64);
    let deadline = Instant::now() + PATIENCE * 5;
    loop {
        if !stop.load(Ordering::Relaxed) {
            made += 3;
        } else if stored == made {
            session.close().await.expect("the session closes");
            return made;
        }
        assert!(
            Instant::now() < deadline,
            "{name}: {stored} of {made} acknowledged in time"
        );
        let last = made.min(stored + 50);
        let said = send(&session, &name, stored + 1..=last, begun).await;
        if matches!(said, Reply::Answer(_)) {
            said.assert_stored();
            acknowledged.fetch_add(last - stored, Ordering::Relaxed);
            stored = last;
        }
        // A pause between attempts while the hub is down.
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

async fn a_hub_killed_during_ingest_loses_and_duplicates_no_report(database: &str) {
    let (zenoh, settings) = settings(database);
    let mut hub = HubProcess::start(&settings);
    let stop = Arc::new(AtomicBool::new(false));
    let acknowledged = Arc::new(AtomicU64::new(0));
    let nodes: Vec<_> = (0..NODES)
        .map(|index| {
            let (stop, acknowledged) = (Arc::clone(&stop), Arc::clone(&acknowledged));
            tokio::spawn(node(index, zenoh.clone(), stop, acknowledged))
        })
        .collect();
    // More by hand: ALBIREO_KILLS=1000.
    for kill in 0..from_environment("ALBIREO_KILLS", 12) {
        let before = acknowledged.load(Ordering::Relaxed);
        // Then the hub is in the middle of ingest.
        until("more is acknowledged", async || {
            acknowledged.load(Ordering::Relaxed) > before + kill % 7 * 5
        })
        .await;
        // At a different moment of a commit each time.
        tokio::time::sleep(Duration::from_millis(kill * 13 % 40)).await;
        hub.kill().await;
        hub = HubProcess::start(&settings);
    }
    stop.store(true, Ordering::Relaxed);
    let mut made = Vec::new();
    for node in nodes {
        made.push(node.await.expect("the node ends"));
    }
    let total: u64 = made.iter().sum();
    assert!(total > 0);

    for (index, made) in made.into_iter().enumerate() {
        hub.has_each_once(&format!("car-{index}"), made).await;
    }
    let energy = &hub.get("/api/v1/energy").await["groups"][0];
    assert_eq!(energy["clips"], total);
    assert_eq!(energy["joules"], total as f64 * 10.0);
}

on_both!(a_hub_killed_during_ingest_loses_and_duplicates_no_report);
