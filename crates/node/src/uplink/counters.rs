//! The cameras' counters on the uplink, while somebody watches.

use crate::board::Board;
use albireo_service::clock::unix_nanoseconds;
use albireo_wire::FleetKeys;
use std::time::{Duration, Instant};
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

/// Time between two messages of a camera, with room for a timer that is early.
const PERIOD: Duration = Duration::from_millis(950);

/// Longest time for which the hub may say that somebody watches.
const LONGEST_WATCH: Duration = Duration::from_secs(3600);

/// By camera.
pub(super) type Publishers = Vec<(String, Publisher<'static>)>;

/// Publishers for the cameras of `board`.
pub(super) fn declare(
    session: &Session,
    board: &Board,
    keys: &FleetKeys,
) -> zenoh::Result<Publishers> {
    let mut publishers = Vec::new();
    for camera in board.cameras() {
        let Ok(keys) = keys.camera(camera.name()) else {
            continue;
        };
        let publisher = session
            .declare_publisher(keys.counters())
            .congestion_control(CongestionControl::Drop)
            .priority(crate::publishing::COUNTERS)
            .wait()?;
        publishers.push((camera.name().to_owned(), publisher));
    }
    Ok(publishers)
}

/// Knows when counters are due.
#[derive(Default)]
pub(super) struct CounterTeller {
    watched_until: Option<Instant>,
    told_at: Option<Instant>,
}

impl CounterTeller {
    /// Somebody watches for so long from now on.
    pub(super) fn watched_for(&mut self, time: Duration) {
        self.watched_until = Some(Instant::now() + time.min(LONGEST_WATCH));
    }

    /// Publishes once a second while somebody watches.
    pub(super) fn tell(&mut self, publishers: &Publishers, board: &Board) -> zenoh::Result<()> {
        let now = Instant::now();
        let due = self.watched_until.is_some_and(|until| now < until)
            && (self.told_at).is_none_or(|at| now.duration_since(at) >= PERIOD);
        if !due {
            return Ok(());
        }
        self.told_at = Some(now);
        for (camera, publisher) in publishers {
            let Some(camera) = board.camera(camera) else {
                continue;
            };
            let message = board.counters(camera, unix_nanoseconds());
            if let Ok(json) = serde_json::to_vec(&message) {
                publisher.put(json).wait()?;
            }
        }
        Ok(())
    }
}
