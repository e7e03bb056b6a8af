//! The hub as a process, killed during ingest: every report is one row in its database.

use crate::support::fleet::{
    HubProcess, deliver, from_environment, now_ns, on_both, settings, uplink,
};
use crate::support::until;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// A node that delivers reports in batches of different sizes. Returns its name and the number of reports.
async fn node(
    name: String,
    zenoh: String,
    stop: CancellationToken,
    acknowledged: Arc<AtomicU64>,
) -> (String, u64) {
    let session = uplink(&zenoh).await;
    let begun = now_ns();
    let mut made = 0;
    while !stop.is_cancelled() {
        let more = 1 + made % 7;
        deliver(&session, &name, made + 1..=made + more, begun).await;
        made += more;
        acknowledged.fetch_add(more, Ordering::Relaxed);
    }
    session.close().await.unwrap();
    (name, made)
}

async fn a_hub_killed_during_ingest_loses_and_duplicates_no_report(database: &str) {
    let (zenoh, settings) = settings(database);
    let mut hub = HubProcess::start(&settings);
    let stop = CancellationToken::new();
    let acknowledged = Arc::new(AtomicU64::new(0));
    let mut nodes = JoinSet::new();
    for index in 0..4 {
        let name = format!("car-{index}");
        let stop = stop.clone();
        nodes.spawn(node(name, zenoh.clone(), stop, Arc::clone(&acknowledged)));
    }
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
    stop.cancel();
    let mut total = 0;
    while let Some(ended) = nodes.join_next().await {
        let (name, made) = ended.unwrap();
        hub.has_each_once(&name, made).await;
        total += made;
    }
    assert!(total > 0);
    let energy = &hub.get("/api/v1/energy").await["groups"][0];
    assert_eq!(energy["clips"], total);
    assert_eq!(energy["joules"], total as f64 * 10.0);
}

// Ten times the limit, for the kills by hand.
on_both! { a_hub_killed_during_ingest_loses_and_duplicates_no_report, 10 }
