//! The way of clip reports: the oldest batch as a query, and what its answer says.

use super::backoff::Backoff;
use super::query::{Asked, Patience, ask};
use crate::delivery::outbox::{Acknowledged, Outbox, OutboxConfig};
use albireo_wire::{BatchCompression, Desired, RefusalReason, ReportAnswer};
use std::time::{Duration, Instant};
use zenoh::query::Querier;

/// Sends batches, and knows when the next may go.
pub(super) struct Delivery {
    outbox: Outbox,
    node: String,
    timeout: Duration,
    backoff: Backoff,
    retry_at: Instant,
}

/// What came of an attempt to deliver.
#[derive(Debug, Default)]
pub(super) struct Delivered {
    /// There may be more to send at once.
    pub again: bool,
    /// A hub has answered, whatever it said.
    pub answered: bool,
    /// A new instance has begun.
    pub new_instance: bool,
    /// The hub could not read the batch.
    pub unreadable: bool,
    /// What the hub desires.
    pub desired: Option<Desired>,
}

impl Delivery {
    pub(super) fn new(outbox: Outbox, node: String, config: &OutboxConfig) -> Self {
        Self {
            outbox,
            node,
            timeout: Duration::from_millis(config.answer_timeout_ms),
            backoff: Backoff::new(config.retry_min_ms, config.retry_max_ms),
            retry_at: Instant::now(),
        }
    }

    /// Whether a batch may go now.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        now >= self.retry_at
    }

    /// When to look next whether a batch may go: `until`, or earlier when a pause ends before. A pause that is over is
    /// no reason to look at once: what it was for has been tried, or there is nothing to send.
    pub(super) fn next_look(&self, now: Instant, until: Instant) -> Instant {
        if self.retry_at > now {
            until.min(self.retry_at)
        } else {
            until
        }
    }

    /// Sends the oldest batch.
    pub(super) fn send(&mut self, reports: &Querier<'_>, patience: Patience<'_>) -> Delivered {
        let mut delivered = Delivered::default();
        let Some(batch) = self.outbox.batch(&self.node) else {
            self.backoff.reset();
            return delivered;
        };
        let payload = match batch.message.to_payload(BatchCompression::Best) {
            Ok(payload) => payload,
            Err(error) => {
                tracing::error!(%error, "clip reports cannot be written");
                self.not_acknowledged(None);
                return delivered;
            }
        };
        match ask::<ReportAnswer>(reports, payload, self.timeout, patience) {
            Asked::Answered(answer) => {
                delivered.answered = true;
                let stored = answer.stored;
                delivered.desired = answer.desired;
                match self.outbox.acknowledge(&batch, stored) {
                    Acknowledged::Removed(number) => {
                        tracing::debug!(number, stored, "clip reports acknowledged");
                        self.backoff.reset();
                        delivered.again = true;
                    }
                    Acknowledged::NewInstance => {
                        self.backoff.reset();
                        delivered.new_instance = true;
                        delivered.again = true;
                    }
                    Acknowledged::Nothing => {
                        tracing::warn!(
                            stored,
                            first = batch.message.first,
                            "the hub has not stored what was sent"
                        );
                        self.not_acknowledged(None);
                    }
                }
            }
            Asked::Refused(refusal) => {
                delivered.answered = true;
                if refusal.reason == RefusalReason::Conflict && self.outbox.conflict(&batch) {
                    self.backoff.reset();
                    delivered.new_instance = true;
                    delivered.again = true;
                    return delivered;
                }
                delivered.unreadable = refusal.reason == RefusalReason::Unreadable;
                tracing::warn!(reason = ?refusal.reason, refusal.detail, "the hub did not take clip reports");
                self.not_acknowledged(refusal.retry_after_ms.map(Duration::from_millis));
            }
            Asked::Nobody(reason) => {
                tracing::debug!(reason, "clip reports not acknowledged");
                self.not_acknowledged(None);
            }
        }
        delivered
    }

    fn not_acknowledged(&mut self, at_least: Option<Duration>) {
        self.retry_at = Instant::now() + self.backoff.next(at_least);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_that_is_over_is_no_reason_to_look_at_once() {
        let config = OutboxConfig {
            retry_min_ms: 60_000,
            ..OutboxConfig::default()
        };
        let mut delivery = Delivery::new(Outbox::in_memory(), "n".to_owned(), &config);
        let now = Instant::now();
        let second = now + Duration::from_secs(1);
        let hour = now + Duration::from_secs(3600);
        assert!(delivery.is_due(now));
        assert_eq!(delivery.next_look(now, second), second);
        delivery.not_acknowledged(None);
        assert!(!delivery.is_due(now));
        assert_eq!(delivery.next_look(now, second), second);
        let end = delivery.next_look(now, hour);
        assert!(end < hour && end == delivery.retry_at);
        // The pause has ended, and nothing was acknowledged since: a look a second, and not all the time.
        assert!(delivery.is_due(end));
        let later = end + Duration::from_secs(1);
        assert_eq!(delivery.next_look(end, later), later);
    }
}
