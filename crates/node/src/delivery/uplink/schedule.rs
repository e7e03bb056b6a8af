//! Decides when the uplink sends what. Has no clock and no network: callers pass times and results.

use crate::backoff::Backoff;
use crate::outbox::{BatchScope, OutboxConfig, OutboxCounts};
use std::time::{Duration, Instant};

/// The time between two batches with reports that a hub has lost: a whole fleet sends them at the same time.
const AGAIN_EVERY: Duration = Duration::from_secs(10);

/// The number of reports gathered before a batch is sent.
const GATHERED: u64 = 12;

/// The reason a query failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    /// The hub refused.
    Refused {
        /// The shortest time until a retry.
        at_least: Duration,
        /// The hub's reason.
        why: String,
    },
    /// Nobody answered.
    Unanswered,
}

/// Queries of one kind: one at a time, with pauses after failures.
#[derive(Debug)]
struct Attempts {
    is_under_way: bool,
    not_before: Option<Instant>,
    backoff: Backoff,
}

impl Attempts {
    fn new(config: &OutboxConfig, random: u64) -> Self {
        Self {
            is_under_way: false,
            not_before: None,
            backoff: Backoff::new(config.retry_min_ms, config.retry_max_ms, random),
        }
    }

    fn may_begin(&self, now: Instant) -> bool {
        !self.is_under_way && self.not_before.is_none_or(|at| now >= at)
    }

    fn ended<T>(&mut self, outcome: &Result<T, Failure>, now: Instant) {
        self.is_under_way = false;
        self.not_before = match outcome {
            Ok(_) => {
                self.backoff.reset();
                None
            }
            Err(Failure::Refused { at_least, .. }) => {
                Some(now + self.backoff.next().max(*at_least))
            }
            Err(Failure::Unanswered) => Some(now + self.backoff.next()),
        };
    }
}

/// Gathers reports until there are enough, or the first has waited long: each batch costs a query, an answer and a
/// compressor that starts empty. Reports that wait when a session begins are sent at once: their age is unknown.
#[derive(Debug)]
pub(crate) struct Schedule {
    gather: Duration,
    /// The time at which the waiting reports are due; `None` while none wait.
    due_at: Option<Instant>,
    reports: Attempts,
    pulls: Attempts,
    wants_pull: bool,
    /// The earliest time for a batch with reports that a hub has lost.
    again_at: Option<Instant>,
    /// The last time at which a hub answered, or had nothing to answer.
    answered_at: Instant,
    /// The time since which reports are due that no hub acknowledges; `None` while none are.
    owed_since: Option<Instant>,
    /// The hub's reason, if it refused the last batch.
    refused: Option<String>,
    patience: Duration,
    /// The time for which it is normal to reach no hub.
    offline: Duration,
}

/// What a session shows of the hub.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HubPresence {
    /// True if a hub takes reports.
    pub is_connected: bool,
    /// True while somebody watches the node through a hub: then even a single report is worth a batch.
    pub watches: bool,
}

impl HubPresence {
    /// A hub that takes reports, and through which nobody watches.
    #[cfg(test)]
    pub(crate) const UNWATCHED: Self = Self {
        is_connected: true,
        watches: false,
    };
}

/// Why no hub acknowledges the reports that are due.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Trouble {
    /// No hub takes reports.
    NoHub,
    /// A hub takes reports, and does not answer.
    Unanswered,
    /// The hub refuses them, for this reason.
    Refused(String),
}

impl Schedule {
    /// `random` spreads the pauses of nodes.
    pub(crate) fn new(config: &OutboxConfig, random: u64, now: Instant) -> Self {
        Self {
            gather: Duration::from_secs(config.gather_s),
            due_at: Some(now),
            reports: Attempts::new(config, random),
            pulls: Attempts::new(config, random.rotate_left(32)),
            wants_pull: true,
            again_at: None,
            answered_at: now,
            owed_since: None,
            refused: None,
            patience: Duration::from_millis(config.patience_ms),
            offline: Duration::from_secs_f64(config.offline_h * 3600.0),
        }
    }

    /// Begins a session: earlier queries get no answers.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.reports.is_under_way = false;
        self.pulls.is_under_way = false;
        self.due_at = Some(now);
        self.wants_pull = true;
        self.answered_at = now;
    }

    /// Ends a pause, because the node is stopping.
    pub(crate) fn send_now(&mut self, now: Instant) {
        self.due_at = Some(now);
        self.reports.not_before = None;
    }

    /// Requests a pull of the desired setting.
    pub(crate) fn want_pull(&mut self) {
        self.wants_pull = true;
    }

    /// Notes when the waiting reports are due.
    fn gather(&mut self, waiting: u64, now: Instant) {
        if waiting > 0 {
            self.due_at.get_or_insert(now + self.gather);
        } else {
            // What was due has gone; the next report may wait again.
            self.due_at.take_if(|at| *at > now);
        }
    }

    /// Starts a batch if one is due and a hub takes reports, and returns which reports it may have.
    pub(crate) fn next_batch(
        &mut self,
        counts: &OutboxCounts,
        hub: HubPresence,
        now: Instant,
    ) -> Option<BatchScope> {
        let waiting = counts.status.waiting;
        self.gather(waiting, now);
        let is_time = self.due_at.is_some_and(|at| now >= at);
        let is_due = waiting > 0 && (hub.watches || waiting >= GATHERED || is_time);
        let is_again_due = counts.again > 0 && self.again_at.is_none_or(|at| now >= at);
        let is_worth_it = is_due || is_again_due;
        if !is_worth_it || !hub.is_connected {
            self.answered_at = now;
        }
        if !is_worth_it {
            self.owed_since = None;
            return None;
        }
        self.owed_since.get_or_insert(now);
        if !hub.is_connected || !self.reports.may_begin(now) {
            return None;
        }
        self.reports.is_under_way = true;
        if !is_again_due {
            return Some(BatchScope::New);
        }
        self.again_at = Some(now + AGAIN_EVERY);
        Some(BatchScope::NewAndForgotten)
    }

    /// Records the outcome of a batch, or that there was nothing to send.
    pub(crate) fn batch_ended<T>(&mut self, outcome: &Result<T, Failure>, now: Instant) {
        self.reports.ended(outcome, now);
        if !matches!(outcome, Err(Failure::Unanswered)) {
            self.answered_at = now;
        }
        self.refused = match outcome {
            Err(Failure::Refused { why, .. }) => Some(why.clone()),
            _ => None,
        };
        if outcome.is_ok() {
            self.due_at = None;
            self.owed_since = None;
        }
    }

    /// Why reports that are due are not acknowledged, once some attempts have failed, or once no hub was reached for longer
    /// than is normal.
    pub(crate) fn trouble(&self, connected: bool, now: Instant) -> Option<Trouble> {
        let waited = now.saturating_duration_since(self.owed_since?);
        let offline = self.patience.max(self.offline);
        if connected && let Some(why) = &self.refused {
            let is_trouble = waited >= self.patience;
            return is_trouble.then(|| Trouble::Refused(why.clone()));
        }
        if waited < offline {
            return None;
        }
        let trouble = if connected {
            Trouble::Unanswered
        } else {
            Trouble::NoHub
        };
        Some(trouble)
    }

    /// The time for which it is normal to reach no hub.
    pub(crate) const fn offline(&self) -> Duration {
        self.offline
    }

    /// True if a batch is in flight.
    pub(crate) const fn is_sending(&self) -> bool {
        self.reports.is_under_way
    }

    /// Starts a pull of the desired setting if one is due, and returns true if so.
    pub(crate) fn next_pull(&mut self, now: Instant) -> bool {
        let is_due = self.wants_pull && self.pulls.may_begin(now);
        if is_due {
            self.pulls.is_under_way = true;
            self.wants_pull = false;
        }
        is_due
    }

    /// Records the outcome of a pull.
    pub(crate) fn pull_ended<T>(&mut self, outcome: &Result<T, Failure>, now: Instant) {
        self.pulls.ended(outcome, now);
        match outcome {
            Ok(_) => self.answered_at = now,
            Err(_) => self.wants_pull = true,
        }
    }

    /// True if batches have been unanswered for too long.
    pub(crate) fn is_stale(&self, after: Duration, now: Instant) -> bool {
        now.saturating_duration_since(self.answered_at) > after
    }

    /// The time of the next check: `latest`, or the end of a pause if that is earlier.
    pub(crate) fn next_due(&self, latest: Instant, now: Instant) -> Instant {
        let next_pull = if self.wants_pull {
            self.pulls.not_before
        } else {
            None
        };
        let ends = [
            self.reports.not_before,
            next_pull,
            self.again_at,
            self.due_at,
        ];
        ends.into_iter().flatten().filter(|at| *at > now).fold(latest, Instant::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DONE: Result<(), Failure> = Ok(());
    const UNANSWERED: Result<(), Failure> = Err(Failure::Unanswered);
    const CONNECTED: bool = true;
    const NO_HUB: bool = false;
    const NEW: Option<BatchScope> = Some(BatchScope::New);
    const NEW_AND_FORGOTTEN: Option<BatchScope> = Some(BatchScope::NewAndForgotten);

    fn refused(why: &str, at_least: Duration) -> Failure {
        Failure::Refused {
            at_least,
            why: why.to_owned(),
        }
    }

    struct Bench {
        schedule: Schedule,
        start: Instant,
    }

    impl Bench {
        fn new() -> Self {
            let start = Instant::now();
            Self {
                schedule: Schedule::new(&OutboxConfig::default(), 7, start),
                start,
            }
        }

        fn at(&self, ms: u64) -> Instant {
            self.start + Duration::from_millis(ms)
        }

        fn batch(&mut self, waiting: u64, ms: u64) -> Option<BatchScope> {
            self.batch_of(waiting, 0, ms)
        }

        fn batch_of(&mut self, waiting: u64, again: u64, ms: u64) -> Option<BatchScope> {
            let mut counts = OutboxCounts::default();
            counts.status.waiting = waiting;
            counts.again = again;
            let now = self.at(ms);
            self.schedule.next_batch(&counts, HubPresence::UNWATCHED, now)
        }

        /// Lets a pull fail at the start, which then moves to the end of the pause.
        fn pause_after(&mut self, failure: Failure) -> Duration {
            let start = self.start;
            assert!(self.schedule.next_pull(start));
            self.schedule.pull_ended::<()>(&Err(failure), start);
            self.start = self.schedule.next_due(self.at(3_600_000), start);
            let early = self.start - Duration::from_millis(1);
            assert!(!self.schedule.next_pull(early));
            self.start - start
        }

        fn ended(&mut self, outcome: Result<(), Failure>, ms: u64) {
            let now = self.at(ms);
            self.schedule.batch_ended(&outcome, now);
        }
    }

    #[test]
    fn reports_are_gathered_up_to_a_number_or_a_time() {
        let mut bench = Bench::new();
        assert_eq!(bench.batch(0, 0), None);
        assert_eq!(bench.batch(1, 1000), NEW, "the first goes at once");
        assert_eq!(bench.batch(1, 1000), None, "one at a time");
        bench.ended(DONE, 1100);
        for waiting in 1..GATHERED {
            assert_eq!(bench.batch(waiting, 20_000 * waiting), None);
        }
        assert_eq!(bench.batch(GATHERED, 320_000), NEW);
        bench.ended(DONE, 320_100);
        assert_eq!(bench.batch(1, 400_000), None);
        assert_eq!(bench.batch(1, 999_000), None);
        assert_eq!(bench.batch(1, 1_000_000), NEW, "ten minutes");
        // What could not be delivered stays worth it.
        bench.ended(UNANSWERED, 1_000_100);
        assert_eq!(bench.batch(2, 1_002_000), NEW);
        bench.ended(DONE, 1_002_100);
        assert_eq!(bench.batch(3, 1_003_000), None);
        let now = bench.at(1_004_000);
        bench.schedule.begin(now);
        let of_a_new_session = bench.batch(3, 1_004_000);
        assert_eq!(of_a_new_session, NEW);
    }

    #[test]
    fn a_failed_query_is_retried_after_growing_jittered_pauses_until_an_answer() {
        let mut bench = Bench::new();
        // The second time, after an answer and a new notice, the pauses begin short again.
        for _ in 0..2 {
            for seconds in [1, 2, 4, 8, 16, 32, 60, 60] {
                let pause = bench.pause_after(Failure::Unanswered).as_millis();
                let within = 500 * seconds..=1500 * seconds;
                assert!(within.contains(&pause), "{pause} ms, not {within:?}");
            }
            let named = Duration::from_secs(900);
            assert_eq!(bench.pause_after(refused("busy", named)), named);
            assert!(bench.schedule.next_pull(bench.at(0)));
            bench.schedule.pull_ended(&DONE, bench.at(0));
            assert!(!bench.schedule.next_pull(bench.at(3_600_000)));
            bench.schedule.want_pull();
        }
    }

    #[test]
    fn reports_that_a_hub_lost_are_resent_at_a_limited_rate() {
        let mut bench = Bench::new();
        assert_eq!(bench.batch(1, 0), NEW);
        bench.ended(DONE, 0);
        assert_eq!(bench.batch_of(0, 900, 1000), NEW_AND_FORGOTTEN);
        bench.ended(DONE, 1100);
        assert_eq!(bench.batch_of(0, 500, 1200), None);
        // Reports that no hub has do not wait for that.
        assert_eq!(bench.batch_of(GATHERED, 500, 1300), NEW);
        bench.ended(DONE, 1400);
        assert_eq!(bench.batch_of(0, 500, 11_000), NEW_AND_FORGOTTEN);
    }

    #[test]
    fn an_unanswered_batch_makes_the_session_stale_and_is_retried_without_polling() {
        let mut bench = Bench::new();
        let minute = Duration::from_secs(60);
        assert_eq!(bench.batch(0, 500_000), None);
        assert!(!bench.schedule.is_stale(minute, bench.at(500_000)));
        assert_eq!(bench.batch(1, 501_000), NEW);
        bench.ended(UNANSWERED, 511_000);
        assert!(!bench.schedule.is_stale(minute, bench.at(559_000)));
        assert!(bench.schedule.is_stale(minute, bench.at(561_000)));
        let latest = bench.at(2_000_000);
        let end = bench.schedule.next_due(latest, bench.at(511_000));
        assert!(end > bench.at(511_000));
        assert!(end <= bench.at(512_500));
        assert_eq!(bench.schedule.next_due(latest, end), latest);
    }

    #[test]
    fn reports_that_nobody_acknowledges_are_a_trouble_with_a_reason_after_some_attempts() {
        let mut bench = Bench::new();
        let trouble =
            |bench: &Bench, connected, ms| bench.schedule.trouble(connected, bench.at(ms));
        assert_eq!(bench.batch(0, 0), None);
        assert_eq!(trouble(&bench, NO_HUB, 3_600_000), None, "nothing waits");
        // No hub: there is no attempt.
        let mut counts = OutboxCounts::default();
        let now = bench.at(10_000);
        counts.status.waiting = GATHERED;
        let no_hub = HubPresence {
            is_connected: NO_HUB,
            watches: false,
        };
        assert_eq!(bench.schedule.next_batch(&counts, no_hub, now), None);
        assert_eq!(trouble(&bench, NO_HUB, 39_999), None);
        assert_eq!(trouble(&bench, NO_HUB, 40_000), Some(Trouble::NoHub));
        assert!(
            !bench.schedule.is_stale(Duration::from_secs(1), now),
            "nobody to answer"
        );
        // A hub that does not answer, and one that refuses.
        assert_eq!(bench.batch(GATHERED, 41_000), NEW);
        bench.ended(UNANSWERED, 51_000);
        let unanswered = Some(Trouble::Unanswered);
        assert_eq!(trouble(&bench, CONNECTED, 51_000), unanswered);
        let why = "unavailable: the disk is full";
        bench.ended(Err(refused(why, Duration::ZERO)), 60_000);
        bench.schedule.begin(bench.at(61_000));
        let is_refused = Some(Trouble::Refused(why.to_owned()));
        assert_eq!(trouble(&bench, CONNECTED, 61_000), is_refused);
        bench.ended(DONE, 70_000);
        assert_eq!(trouble(&bench, CONNECTED, 3_600_000), None);
    }

    #[test]
    fn no_hub_is_a_trouble_only_after_the_hours_that_are_normal_and_a_refusal_at_once() {
        let config = OutboxConfig {
            offline_h: 12.0,
            ..OutboxConfig::default()
        };
        let mut bench = Bench::new();
        bench.schedule = Schedule::new(&config, 7, bench.start);
        assert_eq!(bench.batch(1, 0), NEW);
        bench.ended(UNANSWERED, 10_000);
        for connected in [NO_HUB, CONNECTED] {
            let at = |seconds: u64| bench.schedule.trouble(connected, bench.at(seconds * 1000));
            assert_eq!(at(12 * 3600 - 1), None);
            assert!(at(12 * 3600).is_some());
        }
        bench.ended(Err(refused("busy", Duration::ZERO)), 31_000);
        let trouble = bench.schedule.trouble(CONNECTED, bench.at(31_000));
        assert!(trouble.is_some());
    }
}
