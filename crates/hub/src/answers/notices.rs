//! Notifies nodes that they should pull their desired setting.

use crate::tuning::Notice;
use albireo_wire::{NodeKeys, RevisionMessage, VERSION};
use std::sync::mpsc::Receiver;
use std::time::Duration;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

/// The number of notices after which there is a pause: thousands of nodes must not pull at the same time.
const NOTICES_AT_ONCE: usize = 50;
const NOTICE_PAUSE: Duration = Duration::from_millis(10);

/// Sends notices until the last sender is dropped. Runs on a thread of its own, because a put may block.
pub(crate) fn send_notices(session: &Session, prefix: &str, notices: &Receiver<Notice>) {
    for (sent, notice) in (1_usize..).zip(notices) {
        let Ok(keys) = NodeKeys::new(prefix, &notice.node) else {
            continue;
        };
        let message = RevisionMessage {
            v: VERSION,
            revision: notice.revision,
        };
        let payload = serde_json::to_vec(&message).unwrap_or_default();
        let put = session
            .put(keys.changed(), payload)
            .congestion_control(CongestionControl::Drop)
            .wait();
        if let Err(error) = put {
            tracing::debug!(%error, node = notice.node, "a notice was not sent");
        }
        if sent.is_multiple_of(NOTICES_AT_ONCE) {
            std::thread::sleep(NOTICE_PAUSE);
        }
    }
}
