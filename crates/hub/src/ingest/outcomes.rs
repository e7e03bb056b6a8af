//! Judges by the outcome of its transactions whether the hub stores reports. An attempt says nothing: an empty transaction
//! succeeds on a full disk, on a standby, and beside a damaged page.

use crate::store::StoreError;
use albireo_service::readiness::Fault;
use parking_lot::Mutex;
use std::time::{Duration, Instant};

/// The hub is not ready if a transaction takes longer than this.
const SLOW: Duration = Duration::from_secs(5);

/// After a failure that passes by itself, such as a full disk, the hub is ready again once a report was stored, or once
/// other rows were written for this long: nodes try again more often than that.
const SETTLED: Duration = Duration::from_secs(60);

/// Time after which an idle hub writes a row, to find out whether it still can.
const PROVE_EVERY: Duration = Duration::from_secs(30);

/// What a commit wrote.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Written {
    /// No row.
    #[default]
    Nothing,
    /// Rows, but no report.
    Rows,
    /// At least one report.
    Reports,
}

/// A failed transaction.
#[derive(Debug)]
struct Failure {
    reason: String,
    at: Instant,
    /// True if it had reports.
    had_reports: bool,
    /// True if the same transaction may succeed later.
    is_temporary: bool,
}

impl Failure {
    /// True if a commit at `now` shows that the hub stores reports again.
    fn is_overcome_by(&self, written: Written, now: Instant) -> bool {
        match written {
            Written::Nothing => false,
            Written::Reports => true,
            Written::Rows => {
                let has_settled = now.saturating_duration_since(self.at) >= SETTLED;
                !self.had_reports || (self.is_temporary && has_settled)
            }
        }
    }
}

/// The outcomes of the writer's transactions.
#[derive(Debug, Default)]
pub(crate) struct Outcomes(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// When the transaction under way began.
    begun: Option<Instant>,
    /// The last failure, until it is overcome.
    failure: Option<Failure>,
    /// When the last row was written.
    written: Option<Instant>,
}

impl Outcomes {
    /// Notes that a transaction begins. Returns true if it should write a row in any case.
    pub(super) fn begin(&self, now: Instant) -> bool {
        let mut state = self.0.lock();
        state.begun = Some(now);
        let is_due = match state.written {
            Some(written) => now.saturating_duration_since(written) >= PROVE_EVERY,
            None => true,
        };
        state.failure.is_some() || is_due
    }

    /// Notes that the transaction was committed.
    pub(super) fn committed(&self, written: Written, now: Instant) {
        let mut state = self.0.lock();
        state.begun = None;
        if written == Written::Nothing {
            return;
        }
        state.written = Some(now);
        if let Some(failure) = &state.failure
            && failure.is_overcome_by(written, now)
        {
            state.failure = None;
        }
    }

    /// Notes that the transaction failed, and whether it had reports.
    pub(super) fn failed(&self, error: &StoreError, had_reports: bool, now: Instant) {
        let mut state = self.0.lock();
        state.begun = None;
        let earlier = state.failure.take();
        // A later failure without reports does not make an earlier one with reports easier to overcome.
        let earlier_had_reports = earlier.is_some_and(|failure| failure.had_reports);
        state.failure = Some(Failure {
            reason: error.to_string(),
            at: now,
            had_reports: had_reports || earlier_had_reports,
            is_temporary: error.is_temporary(),
        });
    }

    /// The fault of the database, if it stores no reports.
    pub(crate) fn fault(&self, now: Instant) -> Option<Fault> {
        let state = self.0.lock();
        if let Some(failure) = &state.failure {
            return Some(Fault::not_ready(failure.reason.as_str()));
        }
        let begun = state.begun?;
        if now.saturating_duration_since(begun) < SLOW {
            return None;
        }
        Some(Fault::not_ready(format!(
            "a transaction waits for the database for more than {} s",
            SLOW.as_secs()
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full() -> StoreError {
        StoreError::Unavailable("full".to_owned())
    }

    fn damaged() -> StoreError {
        StoreError::Statement("malformed".to_owned())
    }

    #[test]
    fn after_a_failed_report_other_rows_do_not_make_a_hub_ready_at_once() {
        let start = Instant::now();
        let at = |s: u64| start + Duration::from_secs(s);
        for (error, ready_after_a_minute) in [(full(), true), (damaged(), false)] {
            let outcomes = Outcomes::default();
            outcomes.committed(Written::Reports, at(0));
            outcomes.failed(&error, true, at(1));
            for written in [Written::Nothing, Written::Rows] {
                assert!(outcomes.begin(at(2)), "a row is written each time");
                outcomes.committed(written, at(2));
                assert!(outcomes.fault(at(2)).is_some(), "{written:?}");
            }
            outcomes.committed(Written::Rows, at(61));
            assert_eq!(outcomes.fault(at(61)).is_none(), ready_after_a_minute);
            outcomes.committed(Written::Reports, at(62));
            assert_eq!(outcomes.fault(at(62)), None);
        }
    }

    #[test]
    fn an_idle_hub_recovers_with_the_first_row_that_it_can_write() {
        let outcomes = Outcomes::default();
        let now = Instant::now();
        outcomes.failed(&full(), false, now);
        outcomes.committed(Written::Nothing, now);
        assert!(outcomes.fault(now).is_some());
        outcomes.committed(Written::Rows, now);
        assert_eq!(outcomes.fault(now), None);
        // It then writes a row twice a minute.
        assert!(!outcomes.begin(now + Duration::from_secs(29)));
        assert!(outcomes.begin(now + Duration::from_secs(30)));
    }

    #[test]
    fn a_transaction_without_an_end_is_a_fault_until_it_ends() {
        let outcomes = Outcomes::default();
        let now = Instant::now();
        outcomes.begin(now);
        assert_eq!(outcomes.fault(now + Duration::from_secs(4)), None);
        let fault = outcomes.fault(now + Duration::from_secs(5)).unwrap();
        assert!(fault.reason.contains("more than 5 s"), "{fault:?}");
        outcomes.committed(Written::Nothing, now + Duration::from_secs(9));
        assert_eq!(outcomes.fault(now + Duration::from_secs(9)), None);
    }
}
