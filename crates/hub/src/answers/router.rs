//! Finds the nodes that have become silent or offline, unless the hub itself cannot be reached.

use crate::presence::Fleet;
use albireo_service::clock::Now;
use albireo_service::readiness::Part;
use std::sync::Arc;
use std::time::{Duration, Instant};
use zenoh::Session;

/// Interval at which the nodes are checked.
const SWEEP: Duration = Duration::from_secs(1);

/// Checks the nodes for as long as it is polled. `router` is the session if all nodes are reached through one router: while
/// that is lost, no node becomes silent.
pub(crate) async fn follow_router(fleet: Arc<Fleet>, connection: Part, router: Option<Session>) {
    let mut before = Instant::now();
    loop {
        tokio::time::sleep(SWEEP).await;
        let is_lost = match &router {
            Some(session) => session.info().transports().await.next().is_none(),
            None => false,
        };
        let now = Now::system();
        if is_lost {
            connection.not_ready("it is not connected, so no node can be reached");
            fleet.pass_over(now.at - before);
        } else {
            connection.works();
            fleet.sweep(now);
        }
        before = now.at;
    }
}
