//! Reads the energy and skip rate of each node's clips of today, so that a fleet can be sorted by them.

use super::Fleet;
use crate::store::Store;
use albireo_service::clock::{DAY_MS, unix_milliseconds};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep};
use utoipa::ToSchema;

/// Pause between two reads: at least this long, and at least this many times as long as the last read, so that a large
/// fleet is read less often.
const PAUSE: Duration = Duration::from_secs(10);
const PAUSE_TIMES: u32 = 200;

/// The energy and skip rate of a node's clips of today. Measured and estimated energy are never added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TodaysEnergy {
    /// Joules read from a meter, even if it covers only part of the time.
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
    /// The sort key, microjoules: the larger of the two, since they are never added.
    pub(crate) fn largest_uj(&self) -> i64 {
        (self.measured_joules.max(self.estimated_joules) * 1e6) as i64
    }
}

/// Reads the energy of today's clips (UTC) periodically.
pub(crate) async fn follow_today(fleet: Arc<Fleet>, store: Store) {
    loop {
        let begun = Instant::now();
        let day = unix_milliseconds().div_euclid(DAY_MS);
        match store.today(day * 86_400).await {
            Ok(today) => fleet.set_today(today),
            Err(error) => tracing::debug!(%error, "the energy of today was not read"),
        }
        sleep(PAUSE.max(begun.elapsed() * PAUSE_TIMES)).await;
    }
}
