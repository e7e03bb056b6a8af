//! Updates once per second: the power figures on the board, every camera's counters on Zenoh, and the target's step.

use crate::error::NodeError;
use crate::publishing::{Congestion, Outlet};
use crate::settings::Settings;
use crate::state::board::Board;
use albireo_power::PowerHandle;
use albireo_service::clock::unix_nanoseconds;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;
use zenoh::Session;

/// The time between two counter messages of a camera.
const PERIOD: Duration = Duration::from_secs(1);

/// The number of counter messages between two saves of the target's threshold for a restart.
const KEEP_EVERY: u32 = 60;

/// Declares the counters key of every camera on the board. The returned future updates the board, puts the counters on
/// these keys, and steps the target, until `shutdown`.
///
/// # Errors
/// [`NodeError`] if Zenoh rejects a declaration.
pub(crate) async fn declare(
    session: &Session,
    board: &Arc<Board>,
    settings: &Arc<Settings>,
    meter: PowerHandle,
    shutdown: CancellationToken,
) -> Result<impl Future<Output = ()> + use<>, NodeError> {
    let mut outlets = Vec::new();
    for camera in &board.cameras {
        let key = camera.keys.counters();
        let congestion = Congestion::COUNTERS;
        outlets.push(Outlet::declare(session, key, congestion, &camera.unpublished).await?);
    }
    let board = Arc::clone(board);
    Ok(run(board, Arc::clone(settings), meter, outlets, shutdown))
}

async fn run(
    board: Arc<Board>,
    settings: Arc<Settings>,
    meter: PowerHandle,
    outlets: Vec<Outlet>,
    shutdown: CancellationToken,
) {
    let mut ticks = tokio::time::interval(PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut before = board.totals(meter.snapshot());
    let mut then = Instant::now();
    let mut second = 0_u32;
    while shutdown.run_until_cancelled(ticks.tick()).await.is_some() {
        let totals = board.totals(meter.snapshot());
        let now = Instant::now();
        board.set_power(totals.power.clone());
        let messages = board.publish_counters(unix_nanoseconds());
        for (outlet, message) in outlets.iter().zip(messages) {
            outlet.put(&*message);
        }
        board.step_target(&totals.clone().since(&before), now - then);
        before = totals;
        then = now;
        second = second.wrapping_add(1);
        if second.is_multiple_of(KEEP_EVERY) {
            // Not awaited: the disk may stall.
            let settings = Arc::clone(&settings);
            spawn_blocking(move || settings.keep_place());
        }
    }
    // The figures at the end are the last ones visible.
    board.set_power(meter.snapshot());
    let _ = spawn_blocking(move || settings.keep_place()).await;
}
