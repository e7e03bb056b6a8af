//! What a node's clips of today used and skipped, read from the database, so that a fleet can be sorted by it.

use super::Fleet;
use crate::store::Store;
use albireo_service::clock::unix_milliseconds;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use tokio::time::{Instant, sleep};
use utoipa::ToSchema;

/// Pause between two readings, and how many times as long as a reading it lasts at least: a large fleet is read less often.
const PAUSE: Duration = Duration::from_secs(10);
const PAUSE_TIMES: u32 = 50;

/// What a node's clips of today used. Measured and estimated energy are never added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TodaysEnergy {
    /// Joules read from a meter, also where it was read for a part of the time.
    pub measured_joules: f64,
    /// Joules computed from utilisation.
    pub estimated_joules: f64,
    /// Share of the frames that skipped the detector, 0 to 1; absent without a frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub skip_rate: Option<f64>,
    /// Share of the detector's boxes on audited skipped frames that were shown, 0 to 1; absent without such a box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recall: Option<f64>,
}

impl TodaysEnergy {
    /// What nodes are sorted by, microjoules: the larger of the two, for they are not added.
    pub(crate) fn largest_uj(&self) -> i64 {
        (self.measured_joules.max(self.estimated_joules) * 1e6) as i64
    }
}

impl Fleet {
    /// Reads again and again what the clips of this day, UTC, used.
    pub(crate) async fn follow_today(&self, store: &Store) {
        loop {
            let begun = Instant::now();
            let day = unix_milliseconds().div_euclid(86_400_000);
            match store.today(day * 86_400).await {
                Ok(today) => self.set_today(today),
                Err(error) => tracing::debug!(%error, "what nodes used today was not read"),
            }
            sleep(PAUSE.max(begun.elapsed() * PAUSE_TIMES)).await;
        }
    }
}
