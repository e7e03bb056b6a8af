//! Counts what is forwarded to a hook or an MQTT broker.

use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};
use utoipa::ToSchema;

/// The counts of one place that messages are forwarded to.
#[derive(Debug)]
pub(crate) struct Forwarded {
    /// The place, without secrets.
    pub to: String,
    sent: AtomicU64,
    failed: AtomicU64,
    dropped: AtomicU64,
}

/// What was forwarded to one place since the start.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ForwardedCounts {
    /// The place: `mqtts://broker.example:8883`, `https://house.example/…`.
    pub to: String,
    /// Messages that the place has acknowledged.
    pub sent: u64,
    /// Attempts that failed; each is repeated later.
    pub failed: u64,
    /// Messages that were given up: too many waited, or the place refused them for good.
    pub dropped: u64,
}

impl Forwarded {
    pub(crate) const fn new(to: String) -> Self {
        Self {
            to,
            sent: AtomicU64::new(0),
            failed: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        }
    }

    /// Counts an acknowledged message.
    pub(crate) fn sent(&self) {
        self.sent.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts a failed attempt.
    pub(crate) fn failed(&self) {
        self.failed.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts messages that were given up.
    pub(crate) fn dropped(&self, messages: u64) {
        self.dropped.fetch_add(messages, Ordering::Relaxed);
    }

    /// The counts.
    pub(crate) fn counts(&self) -> ForwardedCounts {
        ForwardedCounts {
            to: self.to.clone(),
            sent: self.sent.load(Ordering::Relaxed),
            failed: self.failed.load(Ordering::Relaxed),
            dropped: self.dropped.load(Ordering::Relaxed),
        }
    }
}
