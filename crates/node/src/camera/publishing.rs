//! Publishes a camera's messages.
//!
//! A put may wait for room in Zenoh's queues: that of a live camera for a millisecond, after which Zenoh drops what does
//! not fit; that of a camera that loses none for as long as its subscriber takes. Each kind has its priority, as each
//! priority has a queue and a lock in Zenoh: a report that waits for a slow subscriber never delays a detection.

use albireo_service::metrics::Counter;
use serde::Serialize;
use tokio::task::block_in_place;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

/// Priority of a live camera's detections.
pub(crate) const LIVE: Priority = Priority::InteractiveHigh;
/// Priority of the detections of a camera that loses none: such a put may wait for its subscriber.
pub(crate) const EVERY: Priority = Priority::InteractiveLow;
/// Priority of clip reports for subscribers.
pub(crate) const CLIPS: Priority = Priority::DataLow;
/// Priority of counters and status.
pub(crate) const COUNTERS: Priority = Priority::Background;

/// A key that messages are put on.
pub(crate) struct Outlet {
    publisher: Publisher<'static>,
    /// Messages that Zenoh refused.
    unpublished: Counter,
}

impl Outlet {
    pub(crate) const fn new(publisher: Publisher<'static>, unpublished: Counter) -> Self {
        Self {
            publisher,
            unpublished,
        }
    }

    /// Puts a message. Where nothing may be lost, it waits for room, and the worker's other tasks go elsewhere.
    pub(crate) fn put(&self, message: &impl Serialize) {
        let put = || -> zenoh::Result<()> {
            let put = self.publisher.put(serde_json::to_vec(message)?);
            put.encoding(Encoding::APPLICATION_JSON).wait()
        };
        let done = match self.publisher.congestion_control() {
            CongestionControl::Block => block_in_place(put),
            _ => put(),
        };
        if let Err(error) = done {
            self.unpublished.inc();
            let key = self.publisher.key_expr();
            tracing::debug!(%key, %error, "a message was not published");
        }
    }
}
