//! Paces failed attempts.

use std::time::Duration;

/// A pause that doubles with each failure, times 0.5 to 1.5, so that nodes spread out.
#[derive(Debug)]
pub(super) struct Backoff {
    first_ms: u64,
    longest_ms: u64,
    failures: u32,
    random: u64,
}

impl Backoff {
    /// `random` must differ between nodes.
    pub(super) fn new(first_ms: u64, longest_ms: u64, random: u64) -> Self {
        Self {
            first_ms: first_ms.max(1),
            longest_ms: longest_ms.max(1),
            failures: 0,
            random,
        }
    }

    /// Counts a failure and returns the pause after it, at least `at_least`.
    pub(super) fn next(&mut self, at_least: Option<Duration>) -> Duration {
        let doubled = self
            .first_ms
            .saturating_mul(1 << self.failures.min(20))
            .min(self.longest_ms);
        self.failures = self.failures.saturating_add(1);
        // Knuth's linear congruential generator, whose high bits are good.
        self.random = (self.random)
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let jittered = doubled.saturating_mul(500 + (self.random >> 32) % 1000) / 1000;
        Duration::from_millis(jittered.max(1)).max(at_least.unwrap_or_default())
    }

    /// Starts again with the first pause.
    pub(super) const fn reset(&mut self) {
        self.failures = 0;
    }
}
