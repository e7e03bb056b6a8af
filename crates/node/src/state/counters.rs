//! Once a second: every camera's counters on Zenoh, and new power figures on the board.

use crate::camera::publishing::{self, Outlet};
use crate::error::NodeError;
use crate::state::board::Board;
use albireo_power::PowerHandle;
use albireo_service::clock::unix_nanoseconds;
use albireo_wire::{CountersMessage, NodeKeys};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::qos::CongestionControl;

/// Time between two counter messages of a camera.
const PERIOD: Duration = Duration::from_secs(1);

/// Publishes the counters of a node's cameras.
pub(crate) struct Counters {
    board: Arc<Board>,
    power: PowerHandle,
    outlets: BTreeMap<String, Outlet>,
}

impl Counters {
    /// Declares the counters key of every camera on the board.
    ///
    /// # Errors
    /// When Zenoh refuses a declaration.
    pub(crate) async fn declare(
        session: &Session,
        keys: &NodeKeys,
        board: Arc<Board>,
        power: PowerHandle,
    ) -> Result<Self, NodeError> {
        let mut outlets = BTreeMap::new();
        for camera in board.cameras() {
            let publisher = session
                .declare_publisher(keys.camera(camera.name())?.counters())
                .congestion_control(CongestionControl::Drop)
                .priority(publishing::COUNTERS)
                .await
                .map_err(|error| {
                    let error = albireo_service::session::plain(&error);
                    NodeError::Zenoh(format!("counters cannot be published: {error}"))
                })?;
            let outlet = Outlet::new(publisher, camera.unpublished());
            outlets.insert(camera.name().to_owned(), outlet);
        }
        Ok(Self {
            board,
            power,
            outlets,
        })
    }

    /// Publishes until `shutdown`.
    pub(crate) async fn run(self, shutdown: CancellationToken) {
        let mut ticks = tokio::time::interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                // The figures at the end are the last ones anybody sees.
                () = shutdown.cancelled() => return self.board.set_power(self.power.snapshot()),
                _ = ticks.tick() => {}
            }
            self.board.set_power(self.power.snapshot());
            for message in self.board.publish_counters(unix_nanoseconds()) {
                self.publish(&message);
            }
        }
    }

    fn publish(&self, message: &CountersMessage) {
        if let Some(outlet) = self.outlets.get(&message.camera) {
            outlet.put(message);
        }
    }
}
