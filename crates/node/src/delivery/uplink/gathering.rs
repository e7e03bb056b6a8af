//! When the reports that wait are worth a batch: each costs a query, an answer and what compression learns anew.

use crate::delivery::outbox::OutboxConfig;
use std::time::{Duration, Instant};

/// Reports are gathered until there are some, or the first has waited for long. What waits when a session begins goes at
/// once: nobody knows how long it has waited already.
#[derive(Debug)]
pub(super) struct Gathering {
    reports: u64,
    time: Duration,
    /// Since when something waits.
    since: Option<Instant>,
    /// Everything goes at once until the first batch was taken.
    eager: bool,
}

impl Gathering {
    pub(super) fn new(config: &OutboxConfig) -> Self {
        Self {
            reports: config.gather_reports as u64,
            time: Duration::from_secs(config.gather_s),
            since: None,
            eager: true,
        }
    }

    /// A session begins.
    pub(super) fn begin(&mut self) {
        self.eager = true;
    }

    /// A batch was taken; what waits now is gathered anew.
    pub(super) fn sent(&mut self) {
        self.eager = false;
        self.since = None;
    }

    /// Whether so many reports are to be sent now.
    pub(super) fn is_worth_it(&mut self, waiting: u64, now: Instant) -> bool {
        if waiting == 0 {
            self.since = None;
            return false;
        }
        let since = *self.since.get_or_insert(now);
        self.eager || waiting >= self.reports || now.saturating_duration_since(since) >= self.time
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_are_gathered_until_there_are_some_or_one_has_waited_for_long() {
        let config = OutboxConfig {
            gather_reports: 8,
            gather_s: 600,
            ..OutboxConfig::default()
        };
        let mut gathering = Gathering::new(&config);
        let begun = Instant::now();
        let at = |seconds| begun + Duration::from_secs(seconds);
        assert!(!gathering.is_worth_it(0, at(0)));
        assert!(gathering.is_worth_it(1, at(1)), "the first goes at once");
        gathering.sent();
        assert!(!gathering.is_worth_it(0, at(2)));
        for waiting in 1..8 {
            assert!(!gathering.is_worth_it(waiting, at(40 * waiting)));
        }
        assert!(gathering.is_worth_it(8, at(320)));
        gathering.sent();
        assert!(!gathering.is_worth_it(1, at(400)));
        assert!(!gathering.is_worth_it(1, at(999)));
        assert!(
            gathering.is_worth_it(1, at(1000)),
            "one has waited ten minutes"
        );
        // What could not be delivered stays worth it.
        assert!(gathering.is_worth_it(2, at(1001)));
        gathering.sent();
        gathering.begin();
        assert!(gathering.is_worth_it(3, at(1002)), "a new session begins");
    }
}
