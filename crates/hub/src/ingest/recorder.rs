//! Stores batches of reports, each group in one transaction, and makes their answers. No thread, no network, no clock.

use super::commit::{Committed, Numbers, write};
use super::decode::Batch;
use super::limits::{ClockCheck, EventLimits};
use crate::config::HistoryConfig;
use crate::presence::News;
use crate::store::retention::{STEP, retain};
use crate::store::{Database, Store, StoreError};
use albireo_service::clock::Now;
use albireo_wire::ReportAnswer;
use std::time::{Duration, Instant};
use uuid::Uuid;

/// Interval of looking for what is too old, when nothing was found.
const RETENTION: Duration = Duration::from_secs(60);

/// Stores batches in a database.
pub struct Recorder {
    database: Box<dyn Database>,
    /// That of the database; known once a first transaction has succeeded.
    identity: Option<Uuid>,
    history: HistoryConfig,
    numbers: Numbers,
    event_limits: EventLimits,
    clock: ClockCheck,
    retention_due: Instant,
}

/// What was committed.
#[derive(Debug)]
pub struct Recorded {
    /// The answer to each batch, in order. There is none before the commit.
    pub answers: Vec<ReportAnswer>,
    pub(crate) committed: Committed,
}

impl Recorder {
    /// Connects at the first use.
    pub fn new(store: &Store, history: &HistoryConfig, now: Now) -> Self {
        Self {
            database: store.database(),
            identity: None,
            history: history.clone(),
            numbers: Numbers::default(),
            event_limits: EventLimits::default(),
            clock: ClockCheck::new(now.at, now.unix_ms),
            retention_due: now.at,
        }
    }

    /// Whether a transaction has succeeded.
    pub(crate) const fn is_proven(&self) -> bool {
        self.identity.is_some()
    }

    /// Whether it is time to look for what is too old.
    pub fn retention_is_due(&self, now: Instant) -> bool {
        self.retention_due <= now
    }

    /// Stores these batches and `news` in one transaction, and deletes some of what is too old if `retention` is due.
    ///
    /// # Errors
    /// When the database refuses it: then nothing was stored.
    pub fn record(
        &mut self,
        batches: &[Batch],
        news: &News,
        retention: bool,
        now: Now,
    ) -> Result<Recorded, StoreError> {
        let recorded = self.transaction(batches, news, retention, now);
        if recorded.is_err() {
            // What was handed out under this transaction means nothing any more.
            self.numbers.forget();
            self.database.disconnect();
        }
        recorded
    }

    fn transaction(
        &mut self,
        batches: &[Batch],
        news: &News,
        retention: bool,
        now: Now,
    ) -> Result<Recorded, StoreError> {
        let identity = match self.identity {
            Some(identity) => identity,
            None => self.database.identity()?,
        };
        let mut writing = self.database.begin()?;
        let (numbers, limits) = (&mut self.numbers, &mut self.event_limits);
        let mut events = news.write(&mut *writing, now.unix_ms)?;
        let mut committed = write(&mut *writing, numbers, limits, batches, now.unix_ms)?;
        events.append(&mut committed.events);
        let mut deleted = 0;
        if retention && self.clock.is_believed(now.at, now.unix_ms) {
            deleted = retain(&mut *writing, &self.history, now.unix_ms)?;
        }
        writing.events(&events)?;
        writing.commit()?;
        self.identity = Some(identity);
        if retention {
            let more = deleted >= STEP.unsigned_abs();
            let pause = if more { Duration::ZERO } else { RETENTION };
            self.retention_due = now.at + pause;
        }
        for batch in batches {
            self.clock.note(&batch.node, batch.clocks_agree);
        }
        committed.events = events;
        let answers = (committed.outcomes.iter_mut())
            .map(|outcome| ReportAnswer {
                refused: std::mem::take(&mut outcome.refused),
                missing: std::mem::take(&mut outcome.wanted),
                ..ReportAnswer::new(identity)
            })
            .collect();
        Ok(Recorded { answers, committed })
    }
}
