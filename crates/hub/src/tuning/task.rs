//! The task that follows orders, rollouts and trials while the hub runs.

use super::tuner::Tuner;
use albireo_service::clock::unix_milliseconds;
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Interval at which reports of nodes are read.
const LOOK: Duration = Duration::from_millis(250);
/// Such intervals between two checks of rollouts, trials, other hubs' changes and drift.
const DRIVE_EVERY: u64 = 4;
const LEARN_EVERY: u64 = 8;
const DRIFT_EVERY: u64 = 20;

/// Follows until `shutdown`. A database that is away is tried again at the next look.
pub(crate) async fn follow(tuner: Arc<Tuner>, shutdown: CancellationToken) {
    let mut every = tokio::time::interval(LOOK);
    every.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut looks = 0_u64;
    let mut failing = false;
    loop {
        tokio::select! {
            _ = every.tick() => {}
            () = shutdown.cancelled() => return,
        }
        let now = unix_milliseconds();
        let look = looks;
        let worked = async {
            tuner.look(now).await?;
            if look.is_multiple_of(DRIVE_EVERY) {
                tuner.drive(now).await?;
            }
            if look.is_multiple_of(LEARN_EVERY) {
                tuner.learn().await?;
            }
            if look.is_multiple_of(DRIFT_EVERY) {
                tuner.look_for_drift(now).await?;
            }
            Ok::<_, crate::store::StoreError>(())
        };
        looks += 1;
        match worked.await {
            Ok(()) => failing = false,
            Err(error) if !failing => {
                tracing::warn!(%error, "orders cannot be followed; trying again");
                failing = true;
            }
            Err(error) => tracing::debug!(%error, "orders cannot be followed"),
        }
    }
}
