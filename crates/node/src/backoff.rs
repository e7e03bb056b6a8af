//! Paces failed attempts.

use std::time::Duration;

/// A pause that doubles with each failure, times 0.5 to 1.5, so that nodes spread out.
#[derive(Debug)]
pub(crate) struct Backoff {
    first_ms: u64,
    longest_ms: u64,
    /// The next pause, without jitter.
    next_ms: u64,
    random: u64,
}

impl Backoff {
    /// `random` must differ between nodes.
    pub(crate) const fn new(first_ms: u64, longest_ms: u64, random: u64) -> Self {
        Self {
            first_ms,
            longest_ms,
            next_ms: first_ms,
            random,
        }
    }

    /// Counts a failure and returns the pause after it.
    pub(crate) fn next(&mut self) -> Duration {
        // Knuth's linear congruential generator, whose high bits are good.
        self.random = self
            .random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let jittered = self.next_ms * (500 + (self.random >> 32) % 1000) / 1000;
        self.next_ms = self.longest_ms.min(2 * self.next_ms);
        Duration::from_millis(jittered)
    }

    /// Starts again with the first pause.
    pub(crate) const fn reset(&mut self) {
        self.next_ms = self.first_ms;
    }
}
