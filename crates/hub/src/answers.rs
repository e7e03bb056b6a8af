//! Exchanges messages with the nodes over Zenoh: takes their reports, statuses and pulls, answers them, and sends notices.
//!
//! Zenoh's threads apply a status to the fleet themselves, which takes microseconds. What may block, such as an answer
//! or a notice, is left to other threads.

mod notices;
mod pulls;
mod replies;
mod reports;
mod router;
mod session;
mod statuses;

pub(crate) use notices::send_notices;
pub(crate) use replies::Replies;
pub(crate) use router::follow_router;
pub(crate) use session::{MAX_SESSIONS, SESSION};

use crate::ingest::IngestCounters;
use crate::presence::Fleet;
use crate::tuning::DesiredSettings;
use albireo_wire::Desired;
use std::sync::Arc;

/// The parts of the hub that its answers need.
#[derive(Clone, Debug)]
pub(crate) struct Answers {
    pub(crate) fleet: Arc<Fleet>,
    pub(crate) desired: Arc<DesiredSettings>,
    pub(crate) counters: Arc<IngestCounters>,
    pub(crate) replies: Replies,
}

impl Answers {
    /// The answer to a pull of `node`: its desired setting, and true if it should send its full status.
    fn desired(&self, node: &str) -> Desired {
        Desired {
            heartbeat_s: Some(self.fleet.heartbeat_s()),
            send_full_status: self.fleet.needs_full_status(node),
            ..self.desired.of(node)
        }
    }
}
