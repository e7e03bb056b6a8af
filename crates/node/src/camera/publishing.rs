//! Publishes a camera's messages.
//!
//! A put may wait for room in Zenoh's queues: that of a live camera for a millisecond, after which Zenoh drops what does
//! not fit; that of a camera that loses none for as long as its subscriber takes, on a thread of its own. Each kind has
//! its priority, as each priority has a queue and a lock in Zenoh: a report that waits for a slow subscriber never delays
//! a detection.

use prometheus_client::metrics::counter::Counter;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::Priority;

/// Priority of a live camera's detections.
pub(crate) const LIVE: Priority = Priority::InteractiveHigh;
/// Priority of the detections of a camera that loses none: such a put may wait for its subscriber.
pub(crate) const EVERY: Priority = Priority::InteractiveLow;
/// Priority of clip reports for subscribers.
pub(crate) const CLIPS: Priority = Priority::DataLow;
/// Priority of counters and status.
pub(crate) const COUNTERS: Priority = Priority::Background;

/// Messages of a camera that loses none which wait for room: those after them hold the camera back.
const MOST_WAITING: usize = 2;

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

    /// Puts a message.
    pub(crate) fn put(&self, json: Vec<u8>) {
        let put = self.publisher.put(json);
        if let Err(error) = put.encoding(Encoding::APPLICATION_JSON).wait() {
            self.unpublished.inc();
            let key = self.publisher.key_expr();
            tracing::debug!(%key, %error, "a message was not published");
        }
    }
}

/// Detections of one camera.
pub(crate) enum Detections {
    /// A slow subscriber misses some.
    Live(Outlet),
    /// None is lost: the camera waits for room.
    Every(mpsc::Sender<Vec<u8>>),
}

impl Detections {
    /// Detections that wait for a slow subscriber, and their thread, which ends after the last.
    pub(crate) fn every(outlet: Outlet) -> (Self, JoinHandle<()>) {
        let (sender, mut waiting) = mpsc::channel(MOST_WAITING);
        let thread = tokio::task::spawn_blocking(move || {
            while let Some(json) = waiting.blocking_recv() {
                outlet.put(json);
            }
        });
        (Self::Every(sender), thread)
    }

    /// Publishes, or waits for room where nothing may be lost.
    pub(crate) async fn publish(&self, json: Vec<u8>) {
        match self {
            Self::Live(outlet) => outlet.put(json),
            Self::Every(sender) => {
                if sender.send(json).await.is_err() {
                    tracing::error!("detections cannot be published any more");
                }
            }
        }
    }
}
