//! Publishes a camera's messages.
//!
//! A put may wait for room in Zenoh's queues: for a live camera 1 ms, after which Zenoh drops the message; for a camera
//! that must not lose any, until its subscriber makes room. Each kind of message has its own priority, because
//! Zenoh has a queue and a lock per priority: a report that waits for a slow subscriber never delays a detection.

pub(crate) mod ros2;

use crate::error::NodeError;
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::task::block_in_place;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Session, Wait};

/// Priority of a live camera's detections.
pub(crate) const LIVE: Priority = Priority::InteractiveHigh;
/// Priority of the detections of a camera that must not lose any: a put may wait for the subscriber.
const EVERY: Priority = Priority::InteractiveLow;
/// Priority of clip reports for subscribers.
pub(crate) const CLIPS: Priority = Priority::DataLow;
/// Priority of counters and status.
pub(crate) const COUNTERS: Priority = Priority::Background;

/// What happens to the messages on a key while their subscribers are slow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Congestion {
    control: CongestionControl,
    priority: Priority,
}

impl Congestion {
    /// The answers of a live camera are dropped.
    pub(crate) const LIVE_ANSWERS: Self = Self {
        control: CongestionControl::Drop,
        priority: LIVE,
    };
    /// The answers of a camera that must not lose any wait.
    pub(crate) const EVERY_ANSWER: Self = Self {
        control: CongestionControl::Block,
        priority: EVERY,
    };
    /// Counters are dropped.
    pub(crate) const COUNTERS: Self = Self {
        control: CongestionControl::Drop,
        priority: COUNTERS,
    };
}

/// Counts the messages about one camera that were not published.
#[derive(Clone, Debug, Default)]
pub(crate) struct Unpublished(Arc<AtomicU64>);

impl Unpublished {
    /// Counts one message.
    pub(crate) fn count(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// The number of messages.
    pub(crate) fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A key for messages about a camera.
pub(crate) struct Outlet {
    publisher: Publisher<'static>,
    unpublished: Unpublished,
}

impl Outlet {
    /// Declares the key.
    ///
    /// # Errors
    /// [`NodeError`] if Zenoh rejects the declaration.
    pub(crate) async fn declare(
        session: &Session,
        key: String,
        congestion: Congestion,
        unpublished: &Unpublished,
    ) -> Result<Self, NodeError> {
        let publisher = session
            .declare_publisher(key.clone())
            .congestion_control(congestion.control)
            .priority(congestion.priority)
            .await
            .map_err(NodeError::refused(format!("`{key}` cannot be published")))?;
        Ok(Self {
            publisher,
            unpublished: unpublished.clone(),
        })
    }

    /// Puts a message. If nothing may be lost, it waits for room, and the worker's other tasks move to other workers.
    pub(crate) fn put(&self, message: &impl Serialize) {
        let put = || -> zenoh::Result<()> {
            self.publisher
                .put(serde_json::to_vec(message)?)
                .encoding(Encoding::APPLICATION_JSON)
                .wait()
        };
        let done = match self.publisher.congestion_control() {
            CongestionControl::Block => block_in_place(put),
            _ => put(),
        };
        if let Err(error) = done {
            self.unpublished.count();
            let key = self.publisher.key_expr();
            tracing::debug!(%key, %error, "a message was not published");
        }
    }
}
